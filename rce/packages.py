"""Users' own ROS packages at a platform, over HTTP: push, list, share, remove. Blocking."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from typing import BinaryIO
from urllib.parse import quote, urlencode

import msgspec
from msgspec import Struct

from rce import archive
from rce.archive import Contents, Entry
from rce.http import Entry as HttpEntry
from rce.http import bearer
from rce.views.pages import Page

PATH = "/api/v1/packages"
PAGE = 1000  # the most that one answer lists


class Version(Struct, frozen=True):
    """`packages` are ROS packages; `created` is in seconds since 1970."""

    digest: str
    size: int
    packages: list[str]
    created: float


class Package(Struct, frozen=True):
    """`name` is `user/name`; the newest version is the last; `shared` (users, `*` is all) is told of own packages."""

    name: str
    versions: list[Version]
    shared: list[str]


class _Announcement(Struct, frozen=True):
    name: str
    digest: str
    size: int


class _Invitation(Struct, frozen=True):
    upload: str
    token: str


class _Users(Struct, frozen=True):
    users: list[str]


class Packages:
    """The packages of the user whose credentials `entry` sends. All raise RceErrors."""

    def __init__(self, entry: HttpEntry) -> None:
        self._entry = entry

    def list(self) -> list[Package]:
        """Own packages, and those that others share, by their names."""
        found, after = [], ""
        while True:
            query = urlencode({"limit": PAGE, "after": after})
            page = msgspec.json.decode(self._entry.json("GET", f"{PATH}?{query}"), type=Page[Package])
            found += page.items
            after = page.next
            if not after:
                return found

    def push(self, name: str, entries: Sequence[Entry]) -> Contents:
        """Make files the newest version of a package. What the platform has already is not sent again."""
        with tempfile.TemporaryFile() as file:
            archive.write(entries, file)
            file.seek(0)
            contents = archive.inspect(file)
            body = self._entry.json("POST", PATH, _Announcement(name, contents.digest, contents.size))
            invitation = msgspec.json.decode(body, type=_Invitation)
            if invitation.upload:
                file.seek(0)
                self._send(file, contents.size, invitation)
        return contents

    def _send(self, file: BinaryIO, size: int, invitation: _Invitation) -> None:
        headers = {**bearer(invitation.token), "Content-Type": "application/x-tar", "Content-Length": str(size)}
        with self._entry.open("PUT", invitation.upload, file, **headers) as answer:
            answer.read()

    def share(self, name: str, users: Sequence[str]) -> None:
        """Let others use a package of yours; `*` is everybody."""
        self._entry.json("POST", f"{PATH}/{quote(name, '')}/shares", _Users([*users]))

    def unshare(self, name: str, users: Sequence[str]) -> None:
        """Let them use it no more, or nobody if `users` is empty. What runs with it goes on."""
        path = f"{PATH}/{quote(name, '')}/shares"
        for each in [f"{path}/{quote(user, '')}" for user in users] or [path]:
            self._entry.json("DELETE", each)

    def remove(self, name: str, version: str = "") -> None:
        """Remove a package, or one version of it. What runs with it goes on."""
        path = f"{PATH}/{quote(name, '')}"
        self._entry.json("DELETE", f"{path}/versions/{quote(version, '')}" if version else path)
