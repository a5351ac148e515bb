"""`rce restore FILE`: puts a backup in the place of a Master that does not run."""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import os
import re
import shutil
import sys
import tarfile
import tempfile
import time
from pathlib import Path

import msgspec

from master.storage import dump
from master.storage.backup import (
    DATABASE,
    FORMAT,
    MANIFEST,
    PACKAGES,
    SETTINGS,
    Manifest,
    Place,
    add_place_options,
    files,
    find_place,
)
from master.storage.store import Store
from rce.errors import AlreadyExists, InvalidRequest, RceError, describe_os_error
from rce.packages.archive import DIGEST
from rce.process.lock import lock_directory

_TABLE = re.compile(rf"{DATABASE}/[a-z_]{{1,64}}\.jsonl")
_PACKAGE = re.compile(rf"{PACKAGES}/{DIGEST.pattern}")


async def restore(file: Path, place: Place, replace: bool = False) -> Manifest:
    """Restore a backup. Nothing is changed before the whole of it was read and checked.

    Args:
        file: The backup.
        place: Where to restore it. Settings are restored only if the place has a directory for them.
        replace: Replace a database that has users, and settings that differ.

    Raises:
        InvalidRequest: The file is not a backup, is damaged, or was written by a later version of RCE.
        AlreadyExists: A Master uses the place, or has users or other settings there.
        OSError: The backup cannot be read, or the place not be written.
    """
    with lock_directory(place.data, "Master"), tempfile.TemporaryDirectory(dir=place.data) as directory:
        unpacked = Path(directory)
        manifest = _unpack(file, unpacked)
        if not replace:
            _check_settings(unpacked / SETTINGS, place)
        store = Store(place.database)
        try:
            await store.run(lambda connection: dump.read(connection, unpacked / DATABASE, manifest.revision, replace))
        finally:
            await store.close()
        _move(unpacked / PACKAGES, place.packages)
        if place.settings is not None:
            _move(unpacked / SETTINGS, place.settings)
        for path in place.data.glob("master.db*"):
            _give(path, place.data)
    return manifest


def _unpack(file: Path, into: Path) -> Manifest:
    """Unpack a backup and check it against its manifest."""
    digests: dict[str, str] = {}
    try:
        with tarfile.open(file) as archive:
            for entry in archive:
                if not entry.isreg() or not _is_expected(entry.name):
                    raise InvalidRequest(f"{file} is not a backup of RCE: it has {entry.name!r}")
                archive.extract(entry, into, filter="data")
                with (into / entry.name).open("rb") as content:
                    digests[entry.name] = hashlib.file_digest(content, "sha256").hexdigest()
        manifest = msgspec.json.decode((into / MANIFEST).read_bytes(), type=Manifest)
    except (tarfile.TarError, EOFError, FileNotFoundError, msgspec.DecodeError) as error:
        if isinstance(error, FileNotFoundError) and not file.exists():
            raise
        raise InvalidRequest(f"{file} is not a whole backup of RCE: {error}") from None
    if manifest.format != FORMAT:
        raise InvalidRequest(f"{file} was written by RCE {manifest.rce}, a later version: restore it with that one")
    del digests[MANIFEST]
    if digests != manifest.files:
        changed = sorted(name for name in digests | manifest.files if digests.get(name) != manifest.files.get(name))
        raise InvalidRequest(f"{file} is damaged: {', '.join(changed[:3])}")
    for name in (DATABASE, PACKAGES, SETTINGS):
        (into / name).mkdir(exist_ok=True)
    return manifest


def _is_expected(name: str) -> bool:
    parts = name.split("/")
    if parts[0] == SETTINGS:
        return len(parts) > 1 and not {"", ".", ".."} & set(parts)
    return name == MANIFEST or bool(_TABLE.fullmatch(name) or _PACKAGE.fullmatch(name))


def _check_settings(unpacked: Path, place: Place) -> None:
    """Refuse to overwrite settings that differ."""
    if place.settings is None:
        return
    for source in files(unpacked):
        target = place.settings / source.relative_to(unpacked)
        if target.exists() and target.read_bytes() != source.read_bytes():
            raise AlreadyExists(
                f"{target} differs from the one in the backup: give --replace to overwrite the settings"
            )


def _move(source: Path, target: Path) -> None:
    """Move files to a directory, each in one step over what is there, whose owner it keeps."""
    for path in files(source):
        to = target / path.relative_to(source)
        _make_directory(to.parent)
        partial = to.with_name(f".{to.name}.partial")
        shutil.move(path, partial)  # the target may be on another disk
        _give(partial, to if to.exists() else to.parent)
        partial.replace(to)


def _make_directory(path: Path) -> None:
    if not path.exists():
        _make_directory(path.parent)
        path.mkdir(mode=0o700)
        _give(path, path.parent)


def _give(path: Path, model: Path) -> None:
    """Give what root restored to the owner of `model`, because the Master runs as another user."""
    if os.geteuid() == 0:
        owner = model.stat()
        os.chown(path, owner.st_uid, owner.st_gid)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    whole = argparse.ArgumentParser(
        prog="rce restore", description="Restore a backup. The Master must not run; start it afterwards."
    )
    add_place_options(whole)
    whole.add_argument("--replace", action="store_true", help="replace users, and settings that differ")
    return whole


def main() -> int:
    """Run the command line and return the exit status."""
    options = parser().parse_args()
    try:
        place = find_place(options)
        manifest = asyncio.run(restore(options.file, place, options.replace))
    except (RceError, OSError) as error:
        reason = describe_os_error(error) if isinstance(error, OSError) else error
        print(f"rce restore: {reason}", file=sys.stderr)
        return 1
    when = time.strftime("%Y-%m-%d %H:%M", time.localtime(manifest.time))
    print(f"restored what RCE {manifest.rce} saved on {when} to {place.data}; start the Master with this directory now")
    return 0


if __name__ == "__main__":
    sys.exit(main())
