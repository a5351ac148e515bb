"""Backups of a Master; tests/master/storage/test_restore.py reads them."""

from __future__ import annotations

import errno
import hashlib
import os
import tarfile
from argparse import Namespace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from master.access.users import Users
from master.storage import backup
from master.storage.backup import MANIFEST, Manifest, Place, find_place, parser, save
from master.storage.store import Store
from rce.errors import InvalidRequest, NotFound


@pytest.fixture
def place(tmp_path: Path, store: Store, users: Users) -> Place:
    """Data directory of a running Master with a user and two packages, and settings."""
    packages, settings = tmp_path / "packages", tmp_path / "etc"
    (packages / "incoming").mkdir(parents=True)
    (packages / "incoming" / "tmp123").write_bytes(b"unfinished")
    for content in (b"first", b"second"):
        (packages / hashlib.sha256(content).hexdigest()).write_bytes(content)
    (settings / "authority").mkdir(parents=True)
    (settings / "authority" / "ca.key").write_text("key")
    (settings / "link").symlink_to("/etc/passwd")
    return Place(tmp_path, f"sqlite:///{tmp_path / 'master.db'}", settings)


async def test_backup_has_database_packages_settings_and_their_digests(place: Place, tmp_path: Path) -> None:
    file = tmp_path / "backup.tar"
    manifest = await save(place, file)
    with tarfile.open(file) as archive:
        names = archive.getnames()
        assert names[-1] == MANIFEST
        assert sorted(names[:-1]) == sorted(manifest.files)
        contents = {name: archive.extractfile(name).read() for name in names}  # type: ignore[union-attr]
    assert msgspec.json.decode(contents[MANIFEST], type=Manifest) == manifest
    assert {name: hashlib.sha256(contents[name]).hexdigest() for name in manifest.files} == manifest.files
    assert contents["settings/authority/ca.key"] == b"key"
    assert "settings/link" not in contents
    assert {contents[name] for name in names if name.startswith("packages/")} == {b"first", b"second"}
    assert b'"name":"ann"' in contents["database/users.jsonl"]
    assert file.stat().st_mode & 0o777 == 0o600
    assert not [name for name in os.listdir(tmp_path) if name.startswith((".", "tmp"))]


async def test_package_that_is_removed_meanwhile_is_left_out(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = place.packages / ("0" * 64)
    monkeypatch.setattr(backup, "_packages", lambda _: [gone])
    manifest = await save(place, place.data / "backup.tar")
    assert not any(name.startswith("packages/") for name in manifest.files)


async def test_full_disk_leaves_the_last_backup(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    file = place.data / "backup.tar"
    file.write_bytes(b"last")

    def fail(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(file))

    monkeypatch.setattr(backup, "_add", fail)
    with pytest.raises(OSError, match="No space"):
        await save(place, file)
    assert file.read_bytes() == b"last"
    assert list(place.data.glob(".*")) == []


@pytest.mark.parametrize("directory", ["absent", "etc"])
async def test_directory_without_a_master_is_named(place: Place, directory: str) -> None:
    data = place.data / directory
    with pytest.raises(NotFound, match=str(data)):
        await save(Place(data, f"sqlite:///{data / 'master.db'}", None), place.data / "backup.tar")
    assert not (data / "master.db").exists()


def options(*words: str) -> Namespace:
    return parser().parse_args(["FILE", *words])


def test_place_is_found_by_options_or_settings(tmp_path: Path) -> None:
    config = tmp_path / "master.toml"
    config.write_text('data_dir = "/var/lib/rce/master"\n')
    data = Path("/var/lib/rce/master")
    assert find_place(options("--config", str(config))) == Place(data, f"sqlite:///{data}/master.db", tmp_path)
    assert find_place(options("--data-dir", "/d")) == Place(Path("/d"), "sqlite:////d/master.db", None)
    assert find_place(options("--data-dir", "/d", "--database", "x://")).database == "x://"
    assert find_place(options()).data == Path("~/.local/share/rce/master").expanduser()
    config.write_text('database = "postgresql://h/d"\n')
    assert find_place(options("--config", str(config), "--data-dir", "/d")).database == "postgresql://h/d"


@pytest.mark.parametrize("content", [None, "data_dir = "])
def test_unreadable_settings_are_named(tmp_path: Path, content: str | None) -> None:
    config = tmp_path / "master.toml"
    if content is not None:
        config.write_text(content)
    with pytest.raises(InvalidRequest, match=str(config)):
        find_place(options("--config", str(config)))
