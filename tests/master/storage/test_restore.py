"""Backups are restored to another directory."""

from __future__ import annotations

import hashlib
import io
import os
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from master.access.users import Users, digest
from master.storage.backup import Place, save
from master.storage.restore import restore
from master.storage.store import Store
from rce.api.roles import Principal
from rce.errors import AlreadyExists, InvalidRequest, Unauthorized
from rce.process.lock import lock_directory

PACKAGE = b"package"
NAME = hashlib.sha256(PACKAGE).hexdigest()


@pytest.fixture
async def file(tmp_path: Path, store: Store, users: Users) -> Path:
    """Backup of a Master with the user ann, a package and settings."""
    (tmp_path / "packages").mkdir()
    (tmp_path / "packages" / NAME).write_bytes(PACKAGE)
    (tmp_path / "etc" / "authority").mkdir(parents=True)
    (tmp_path / "etc" / "authority" / "ca.key").write_text("key")
    await save(Place(tmp_path, f"sqlite:///{tmp_path / 'master.db'}", tmp_path / "etc"), tmp_path / "backup.tar")
    return tmp_path / "backup.tar"


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """Another place, with nothing in it yet."""
    data = tmp_path / "other"
    return Place(data, f"sqlite:///{data / 'master.db'}", tmp_path / "other-etc")


async def log_in(place: Place, name: str, password: str) -> Principal:
    store = Store(place.database)
    await store.open()
    try:
        return await Users(store).check(name, digest(password))
    finally:
        await store.close()


async def add_bob(place: Place) -> None:
    place.data.mkdir()
    store = Store(place.database)
    await store.open()
    await Users(store).add("bob", "secret")
    await store.close()


async def test_everything_is_restored_elsewhere(file: Path, place: Place) -> None:
    await restore(file, place)
    assert await log_in(place, "ann", "secret") == Principal("ann", "user")
    assert (place.packages / NAME).read_bytes() == PACKAGE
    assert place.settings is not None
    assert (place.settings / "authority" / "ca.key").read_text() == "key"
    assert (place.data / "master.db").stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to others")
async def test_files_belong_to_the_user_of_the_master(file: Path, place: Place) -> None:
    assert place.settings is not None
    config = place.settings / "authority" / "ca.key"
    config.parent.mkdir(parents=True)
    config.write_text("another")
    place.data.mkdir()
    os.chown(place.data, 1234, 1235)
    os.chown(config, 0, 1235)
    await restore(file, place, replace=True)
    owners = {path: (path.stat().st_uid, path.stat().st_gid) for path in (place.packages / NAME, config)}
    assert owners == {place.packages / NAME: (1234, 1235), config: (0, 1235)}
    assert os.stat(place.data / "master.db").st_uid == 1234


async def test_users_and_settings_are_replaced_only_when_told(file: Path, place: Place) -> None:
    await add_bob(place)
    with pytest.raises(AlreadyExists, match="--replace"):
        await restore(file, place)
    assert await log_in(place, "bob", "secret") == Principal("bob", "user")
    assert not place.packages.exists()

    await restore(file, place, replace=True)
    assert await log_in(place, "ann", "secret") == Principal("ann", "user")
    with pytest.raises(Unauthorized):
        await log_in(place, "bob", "secret")


async def test_differing_settings_are_refused_before_anything_changes(file: Path, place: Place) -> None:
    assert place.settings is not None
    (place.settings / "authority").mkdir(parents=True)
    (place.settings / "authority" / "ca.key").write_text("another")
    with pytest.raises(AlreadyExists, match=r"ca\.key"):
        await restore(file, place)
    assert not (place.data / "master.db").exists()
    await restore(file, place, replace=True)
    assert (place.settings / "authority" / "ca.key").read_text() == "key"


async def test_running_master_is_not_touched(file: Path, place: Place) -> None:
    with lock_directory(place.data, "Master"), pytest.raises(AlreadyExists, match="another Master"):
        await restore(file, place)


def change(file: Path, edit: Callable[[bytes], bytes]) -> None:
    file.write_bytes(edit(file.read_bytes()))


@pytest.mark.parametrize("size", [0, 600, 5000, -1])
async def test_truncated_backup_is_refused(file: Path, place: Place, size: int) -> None:
    change(file, lambda content: content[: size if size >= 0 else content.index(b"manifest.json")])
    with pytest.raises(InvalidRequest, match="not a whole backup"):
        await restore(file, place)
    assert not (place.data / "master.db").exists()


async def test_damaged_backup_is_refused(file: Path, place: Place) -> None:
    change(file, lambda content: content.replace(PACKAGE + b"\0", b"another" + b"\0"))
    with pytest.raises(InvalidRequest, match=f"damaged: packages/{NAME}"):
        await restore(file, place)
    assert not (place.data / "master.db").exists()


@pytest.mark.parametrize("name", ["settings/../../evil", "/etc/evil", "other", "packages/x", "database/../x.jsonl"])
async def test_other_archives_are_refused(tmp_path: Path, place: Place, name: str) -> None:
    file = tmp_path / "other.tar"
    with tarfile.open(file, "w") as archive:
        entry = tarfile.TarInfo(name)
        entry.size = 1
        archive.addfile(entry, io.BytesIO(b"x"))
    with pytest.raises(InvalidRequest, match="not a backup of RCE"):
        await restore(file, place)
    assert not (tmp_path / "evil").exists()


async def test_absent_file_is_named(tmp_path: Path, place: Place) -> None:
    with pytest.raises(FileNotFoundError, match=r"no\.tar"):
        await restore(tmp_path / "no.tar", place)
