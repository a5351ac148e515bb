"""`rce backup FILE`: saves a Master's database, the packages of its users, and its settings, while the Master runs.

A backup is a tar file: `database/TABLE.jsonl`, `packages/DIGEST`, `settings/…` and at its end `manifest.json`, which
has the SHA-256 of each of the others.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import hashlib
import os
import sys
import tarfile
import tempfile
import time
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import BinaryIO, NamedTuple

import msgspec
from msgspec import Struct

from master.storage import dump
from master.storage.archives import Archives
from master.storage.directory import DATABASE as MASTER_DATABASE
from master.storage.directory import existing_master_directory, master_directory
from master.storage.store import Store
from rce import __version__
from rce.errors import InvalidRequest, NotFound, RceError, describe_os_error
from rce.packages.archive import DIGEST

FORMAT = 1
MANIFEST = "manifest.json"
DATABASE, PACKAGES, SETTINGS = "database", "packages", "settings"


class Manifest(Struct):
    """Description of a backup.

    Attributes:
        format: Version of this format.
        rce: Version of RCE that wrote it.
        time: When it was written, in seconds since 1970.
        revision: Revision of the database.
        files: SHA-256 of each other file.
    """

    format: int
    rce: str
    time: float
    revision: str
    files: dict[str, str]


class Place(NamedTuple):
    """Files of a Master: its data directory, the URL of its database, and the directory of its settings, if any."""

    data: Path
    database: str
    settings: Path | None

    @property
    def packages(self) -> Path:
        """Directory of the users' packages."""
        return self.data / "packages"


def add_place_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `find_place` reads."""
    parser.add_argument("file", type=Path, metavar="FILE", help="the backup, a tar file")
    parser.add_argument(
        "--config",
        type=Path,
        help="settings of an installed Master (/etc/rce/master.toml), whose directory is saved too",
    )
    parser.add_argument(
        "--data-dir",
        type=Path,
        help="data directory of the Master; DIR/master for `rce up --data-dir DIR` (default: that of `rce up`)",
    )
    parser.add_argument("--database", default="", help="SQLAlchemy URL, if the Master's is not in its data directory")


def find_place(options: argparse.Namespace) -> Place:
    """Return the files of the Master that the options name.

    Raises:
        InvalidRequest: The settings cannot be read.
    """
    settings: dict[str, object] = {}
    if options.config is not None:
        try:
            settings = tomllib.loads(options.config.read_text())
        except (OSError, ValueError) as error:
            raise InvalidRequest(f"settings {options.config}: {error}") from None
    data = options.data_dir or Path(str(settings.get("data_dir", "~/.local/share/rce/master")))
    data = master_directory(data.expanduser())
    database = options.database or str(settings.get("database", "")) or f"sqlite:///{data / MASTER_DATABASE}"
    return Place(data, database, options.config.absolute().parent if options.config is not None else None)


async def save(place: Place, file: Path) -> Manifest:
    """Write a backup, which only the user of this process may read; it has hashes of passwords and private keys.

    Raises:
        NotFound: There is no such Master.
        InvalidRequest: The database is of something else.
        OSError: A file cannot be read, or the backup cannot be written.
    """
    if place.database == f"sqlite:///{place.data / MASTER_DATABASE}":
        existing_master_directory(place.data)
    partial_file = file.with_name(f".{file.name}.partial")
    try:
        with open(partial_file, "wb", opener=_private) as target:  # noqa: ASYNC230  # the program does nothing else
            manifest = await _write(place, target)
            target.flush()
            os.fsync(target.fileno())
        partial_file.replace(file)
    finally:
        partial_file.unlink(missing_ok=True)
    return manifest


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


async def _write(place: Place, target: BinaryIO) -> Manifest:
    manifest = Manifest(FORMAT, __version__, time.time(), "", {})
    with tarfile.open(fileobj=target, mode="w") as archive, tempfile.TemporaryDirectory(dir=place.data) as directory:
        add = partial(_add, archive, manifest)
        for path in _packages(place):
            add(f"{PACKAGES}/{path.name}", path)
        store = Store(place.database)
        try:
            manifest.revision = await store.run(lambda connection: dump.write(connection, Path(directory)))
            for path in _packages(place):  # those that were pushed meanwhile; the database may name them
                if f"{PACKAGES}/{path.name}" not in manifest.files:
                    add(f"{PACKAGES}/{path.name}", path)
            if store.shared:  # those that other Masters stored
                await _add_shared(Archives(store), Path(directory), manifest, add)
        finally:
            await store.close()
        for path in files(Path(directory)):
            add(f"{DATABASE}/{path.name}", path)
        for name, path in _settings(place):
            add(f"{SETTINGS}/{name}", path)
        text = Path(directory) / MANIFEST
        text.write_bytes(msgspec.json.format(msgspec.json.encode(manifest)))
        archive.add(text, MANIFEST)
    return manifest


async def _add_shared(
    archives: Archives, directory: Path, manifest: Manifest, add: Callable[[str, Path], None]
) -> None:
    for digest in sorted(await archives.digests()):
        if f"{PACKAGES}/{digest}" not in manifest.files:
            path = directory / digest
            with contextlib.suppress(NotFound):  # it is being stored, or was removed meanwhile
                await archives.fetch(digest, path)
                add(f"{PACKAGES}/{digest}", path)
                path.unlink()


def files(directory: Path) -> list[Path]:
    """Return all regular files below a directory, sorted."""
    return sorted(path for path in directory.rglob("*") if path.is_file() and not path.is_symlink())


def _packages(place: Place) -> list[Path]:
    return [path for path in files(place.packages) if DIGEST.fullmatch(path.name)]


def _settings(place: Place) -> list[tuple[str, Path]]:
    top = place.settings
    return [] if top is None else [(path.relative_to(top).as_posix(), path) for path in files(top)]


def _add(archive: tarfile.TarFile, manifest: Manifest, name: str, path: Path) -> None:
    """Add a file; a package that was removed meanwhile is left out."""
    try:
        with path.open("rb") as file:
            entry = archive.gettarinfo(arcname=name, fileobj=file)
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            file.seek(0)
            archive.addfile(entry, file)
    except FileNotFoundError:
        if not name.startswith(PACKAGES):
            raise
    else:
        manifest.files[name] = digest


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    whole = argparse.ArgumentParser(
        prog="rce backup",
        description="Save a Master's database, its users' packages and its settings. The Master may run meanwhile. "
        "The backup has private keys and hashes of passwords: keep it safe.",
    )
    add_place_options(whole)
    return whole


def main() -> int:
    """Run the command line and return the exit status."""
    options = parser().parse_args()
    try:
        manifest = asyncio.run(save(find_place(options), options.file))
    except (RceError, OSError) as error:
        reason = describe_os_error(error) if isinstance(error, OSError) else error
        print(f"rce backup: {reason}", file=sys.stderr)
        return 1
    packages = sum(name.startswith(f"{PACKAGES}/") for name in manifest.files)
    settings = sum(name.startswith(f"{SETTINGS}/") for name in manifest.files)
    print(f"{options.file}: the database, packages: {packages}, files of settings: {settings}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
