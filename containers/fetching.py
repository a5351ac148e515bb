"""Fetches archives from the Master's HTTP entry, with the ticket that its control connection gives."""

from __future__ import annotations

import asyncio
import shutil
import ssl
from http.client import HTTPException
from pathlib import Path

from containers.settings import host_of
from rce import http
from rce.calls.environments import FetchPackage, Ticket
from rce.control import MasterLink
from rce.errors import Unavailable
from rce.tls import CA, Tls

CHUNK = 256 * 1024


class Fetcher:
    """`master` is the control address; `entry` the URL of the HTTP entry, empty: its host, and what the ticket says.

    An entry with https has a certificate of the platform's own CA, if there is `tls`, or one that this machine trusts.
    """

    def __init__(self, link: MasterLink, master: str, entry: str = "", tls: Tls | None = None) -> None:
        self._link = link
        self._master = master
        self._entry = entry
        self._trust = ssl.create_default_context()
        if tls is not None:
            self._trust.load_verify_locations(tls.directory / CA)

    async def fetch(self, digest: str, path: Path) -> None:
        """Write the archive of a digest. NotFound, Unavailable; whether it is the right one must be seen."""
        ticket = await self._link.call(FetchPackage(digest))
        url = self._entry or entry_of(self._master, ticket)
        entry = http.Entry(url, http.bearer(ticket.token), self._trust, direct=True)
        await asyncio.to_thread(_download, entry, ticket, path)


def entry_of(master: str, ticket: Ticket) -> str:
    """The URL of the HTTP entry on the host of the Master's control address (a Twisted client endpoint)."""
    host = host_of(master) or "127.0.0.1"
    return f"{ticket.scheme}://{f'[{host}]' if ':' in host else host}:{ticket.port}/"


def _download(entry: http.Entry, ticket: Ticket, path: Path) -> None:
    with entry.open("GET", ticket.path) as answer, path.open("wb") as file:
        try:
            shutil.copyfileobj(answer, file, CHUNK)
        except (OSError, HTTPException) as error:
            raise Unavailable(f"the archive from {entry.url} broke off: {error}") from None
        if file.tell() != ticket.size:
            raise Unavailable(f"the archive from {entry.url} broke off after {file.tell()} of {ticket.size} bytes")
