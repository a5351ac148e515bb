"""Fetches archives from the Master's HTTP entry, with the ticket that its control connection gives."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

from containers.settings import host_of
from rce import http
from rce.calls import FetchPackage, Ticket
from rce.control import MasterLink
from rce.errors import Unavailable

CHUNK = 256 * 1024


class Fetcher:
    """`master` is the control address; `entry` the URL of the HTTP entry, empty: its host, and what the ticket says."""

    def __init__(self, link: MasterLink, master: str, entry: str = "") -> None:
        self._link = link
        self._master = master
        self._entry = entry

    async def fetch(self, digest: str, path: Path) -> None:
        """Write the archive of a digest. NotFound, Unavailable; whether it is the right one must be seen."""
        ticket = await self._link.call(FetchPackage(digest))
        await asyncio.to_thread(_download, self._entry or entry_of(self._master, ticket), ticket, path)


def entry_of(master: str, ticket: Ticket) -> str:
    """The URL of the HTTP entry on the host of the Master's control address (a Twisted client endpoint)."""
    host = host_of(master) or "127.0.0.1"
    return f"{ticket.scheme}://{f'[{host}]' if ':' in host else host}:{ticket.port}/"


def _download(entry: str, ticket: Ticket, path: Path) -> None:
    with http.Entry(entry, http.bearer(ticket.token)).open("GET", ticket.path) as answer, path.open("wb") as file:
        try:
            shutil.copyfileobj(answer, file, CHUNK)
        except OSError as error:
            raise Unavailable(f"the archive from {entry} broke off: {error}") from None
        if file.tell() != ticket.size:
            raise Unavailable(f"the archive from {entry} broke off after {file.tell()} of {ticket.size} bytes")
