"""Implementation of `rce knowledge …`: entries of a platform's knowledge service."""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import msgspec
from msgspec import UNSET

from rce.api.knowledge import Entry, EntryChange, Location, NewEntry, Version
from rce.cli.contexts import running_platform
from rce.cli.output import Columns, local_time, print_record, print_table, size_text, to_json
from rce.cli.session import ConsoleSession
from rce.client.knowledge import KnowledgeClient
from rce.errors import AlreadyExists, InvalidRequest, NotFound, TimedOut, Unavailable

RETRY_DELAY = 1.0  # seconds until a subscription connects anew
MAP_FILES = (".pgm", ".yaml", ".png", ".txt", ".ply", ".pcd", ".db", ".npz", ".json", ".bt", ".obj", ".glb")

ENTRIES: Columns[Entry] = {
    "kind": lambda entry: entry.kind,
    "uid": lambda entry: entry.uid,
    "version": lambda entry: str(entry.version),
    "author": lambda entry: entry.author,
    "modified": lambda entry: local_time(entry.modified),
    "rating": lambda entry: f"{entry.rating:.1f}",
    "files": lambda entry: str(len(entry.files)),
    "description": lambda entry: entry.description,
}
VERSIONS: Columns[Version] = {
    "version": lambda version: str(version.number),
    "time": lambda version: local_time(version.time),
    "author": lambda version: version.author,
    "text": lambda version: size_text(version.size),
    "files": lambda version: ", ".join(file.name for file in version.files),
    "description": lambda version: version.description,
}


def add(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Add an entry, or a version to one that exists."""
    service = _service(args)
    text = None if args.owl is None else _text(args.owl)
    files = [*args.files, *([] if args.map is None else map_files(args.map))]
    missing = [file for file in files if not file.is_file()]
    if missing:
        raise NotFound(f"no such file: {missing[0]}", field="file")
    cls, _, name = args.uid.partition(".")
    location = None if args.place is None else Location(*args.place)
    new = NewEntry(args.kind, cls, name, text or "", args.description or "", args.public, args.shared, location)
    try:
        entry = service.add(new)
    except AlreadyExists:
        change = EntryChange(
            UNSET if text is None else text,
            UNSET if args.description is None else args.description,
            True if args.public else UNSET,
            args.shared or UNSET,
            UNSET if location is None else location,
        )
        entry = service.change(args.kind, args.uid, change)
    for file in files:
        entry = service.put_file(args.kind, entry.uid, file)
    names = [file.name for file in entry.files]
    print_record(entry if args.json else {**msgspec.to_builtins(entry), "files": names}, args.json)


def map_files(directory: Path) -> list[Path]:
    """Return the files of a map.

    Raises:
        NotFound: The directory has none.
    """
    found = sorted(path for path in directory.glob("*") if path.suffix in MAP_FILES)
    if not found:
        raise NotFound(f"{directory} has no files of a map", field="map")
    return found


def get(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print the text of an entry, or write it with its files."""
    service = _service(args)
    text = service.owl(args.kind, args.uid, args.version)
    if args.out is None:
        print(text, end="" if text.endswith("\n") else "\n")
        return
    args.out.mkdir(parents=True, exist_ok=True)
    files = service.get(args.kind, args.uid).files
    if args.version is not None:
        versions = {version.number: version for version in service.versions(args.kind, args.uid)}
        files = versions[args.version].files
    (args.out / f"{args.uid}.owl").write_bytes(text.encode())
    for file in files:
        service.fetch_file(args.kind, args.uid, file.name, args.out / file.name, args.version)
    print(f"in {args.out}: {', '.join([f'{args.uid}.owl', *(file.name for file in files)])}")


def search(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print the entries that fit."""
    found = _service(args).search(
        kind=args.kind,
        prefix=args.prefix,
        text=" ".join(args.text),
        cls=args.cls,
        author=args.author,
        place=None if args.near is None else (args.near[0], args.near[1]),
        radius=args.radius,
    )
    print_table(list(found), ENTRIES, args.json)


def query(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print the answer to a query."""
    text = _text(Path(args.query[1:])) if args.query.startswith("@") else args.query
    result = _service(args).query(text, "serql" if args.serql else "sparql")
    if args.json:
        print(to_json(result))
    elif result.answer is not None:
        print("yes" if result.answer else "no")
    else:
        print_table(result.rows, {name: partial(_cell, column=n) for n, name in enumerate(result.variables)})


def _cell(row: list[str | None], column: int) -> str:
    return row[column] or ""


def history(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print the versions of an entry."""
    print_table(_service(args).versions(args.kind, args.uid), VERSIONS, args.json)


def remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Remove an entry."""
    _service(args).remove(args.kind, args.uid)


def subscribe(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print changes until the user ends it."""
    service, after = _service(args), args.after
    while True:
        try:
            for change in service.changes(kind=args.kind, uid=args.uid, prefix=args.prefix, cls=args.cls, after=after):
                after = change.number
                print(msgspec.json.encode(change).decode(), flush=True)
        except TimedOut:  # there was no change
            continue
        except Unavailable as error:
            print(f"the connection broke and is opened anew: {error}", file=sys.stderr)
        time.sleep(RETRY_DELAY)


def export(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Write an archive."""
    _service(args).export(args.archive)
    print(f"{args.archive}: {size_text(args.archive.stat().st_size)}")


def restore(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Add the entries of an archive."""
    result = _service(args).restore(args.archive)
    print(f"{result.added} added, {len(result.skipped)} already there")


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode()
    except UnicodeDecodeError:
        raise InvalidRequest(f"{path} is not text in UTF-8", field="owl") from None


def _service(args: argparse.Namespace) -> KnowledgeClient:
    access = running_platform(args)
    return KnowledgeClient(access.url, user=access.user, password=access.password, key=access.key)
