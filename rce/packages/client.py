"""Blocking HTTP client for users' own ROS packages on a platform: push, list, share, remove."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from typing import BinaryIO
from urllib.parse import quote, urlencode

import msgspec
from msgspec import Struct

from rce.api.http import EntryClient, bearer
from rce.api.views.pages import Page
from rce.packages import archive
from rce.packages.archive import Contents, Entry

PATH = "/api/v1/packages"
PAGE_SIZE = 1000  # maximum of the API


class Version(Struct, frozen=True):
    """Version of a package: the ROS packages in it, and its time of creation in seconds since 1970."""

    digest: str
    size: int
    packages: list[str]
    created: float


class Package(Struct, frozen=True):
    """Package named `user/name`, with its versions, newest last.

    `shared` are the users with whom it is shared (`*`: all), listed only for the user's own packages.
    """

    name: str
    versions: list[Version]
    shared: list[str]


class _NewVersion(Struct, frozen=True):
    name: str
    digest: str
    size: int


class _UploadTicket(Struct, frozen=True):
    upload: str
    token: str


class _Users(Struct, frozen=True):
    users: list[str]


class PackagesClient:
    """Client for the packages of the user as whom `entry` authenticates.

    All methods raise `Unavailable` if the platform cannot be reached, and otherwise the error with which it answers.
    """

    def __init__(self, entry: EntryClient) -> None:
        self._entry = entry

    def list(self) -> list[Package]:
        """Return the user's own packages and those shared with the user, by name."""
        packages, after = [], ""
        while True:
            query = urlencode({"limit": PAGE_SIZE, "after": after})
            page = msgspec.json.decode(self._entry.json("GET", f"{PATH}?{query}"), type=Page[Package])
            packages += page.items
            after = page.next
            if not after:
                return packages

    def push(self, name: str, entries: Sequence[Entry]) -> Contents:
        """Push files as the newest version of a package. Content that the platform has already is not uploaded.

        Raises:
            InvalidRequest: The files contain no ROS package, or a path or file that an archive cannot hold.
            LimitExceeded: There are too many files, or the user has no room for the package.
        """
        with tempfile.TemporaryFile() as file:
            archive.write(entries, file)
            file.seek(0)
            contents = archive.inspect(file)
            body = self._entry.json("POST", PATH, _NewVersion(name, contents.digest, contents.size))
            ticket = msgspec.json.decode(body, type=_UploadTicket)
            if ticket.upload:
                file.seek(0)
                self._upload(file, contents.size, ticket)
        return contents

    def _upload(self, file: BinaryIO, size: int, ticket: _UploadTicket) -> None:
        headers = {**bearer(ticket.token), "Content-Type": "application/x-tar", "Content-Length": str(size)}
        with self._entry.open("PUT", ticket.upload, file, **headers) as response:
            response.read()

    def share(self, name: str, users: Sequence[str]) -> None:
        """Let other users use one of the user's own packages; `*` is everybody."""
        self._entry.json("POST", f"{PATH}/{quote(name, '')}/shares", _Users([*users]))

    def unshare(self, name: str, users: Sequence[str]) -> None:
        """Stop sharing a package with these users, or with all if none are given. Running environments keep it."""
        path = f"{PATH}/{quote(name, '')}/shares"
        for each in [f"{path}/{quote(user, '')}" for user in users] or [path]:
            self._entry.json("DELETE", each)

    def remove(self, name: str, version: str = "") -> None:
        """Remove a package, or one version of it. Running environments keep it."""
        path = f"{PATH}/{quote(name, '')}"
        self._entry.json("DELETE", f"{path}/versions/{quote(version, '')}" if version else path)
