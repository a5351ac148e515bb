"""Download of package archives from the Master's HTTP entry, with a ticket from the control connection."""

from __future__ import annotations

import asyncio
import shutil
import ssl
from http.client import HTTPException
from pathlib import Path

from containers.settings import host_of
from rce.api import http
from rce.control.calls.environments import DownloadTicket, FetchPackage
from rce.control.client import ControlClient, addresses
from rce.errors import Unavailable
from rce.net.tls import CA, Tls

CHUNK = 256 * 1024


class Fetcher:
    """Downloads package archives from the Master.

    `entry` is the URL of the Master's HTTP entry, or those of several Masters, separated by commas; if it is empty, the
    host of `master`, its control address, is used with the scheme and port of the ticket. With https, certificates of
    the platform's CA (if `tls` is given) and of the CAs that this machine trusts are accepted.
    """

    def __init__(self, link: ControlClient, master: str, entry: str = "", tls: Tls | None = None) -> None:
        self._link = link
        self._master = master
        self._entry = entry
        self._trust = ssl.create_default_context()
        if tls is not None:
            self._trust.load_verify_locations(tls.directory / CA)

    async def fetch(self, digest: str, path: Path) -> None:
        """Write the archive of a digest to a file; the caller must verify its digest.

        Raises:
            NotFound: The Master has no such package.
            Unavailable: The Master cannot be reached, or the transfer was interrupted.
        """
        ticket = await self._link.call(FetchPackage(digest))
        url = self._entry or ",".join(entry_of(each, ticket) for each in addresses(self._master))
        entry = http.EntryClient(url, http.bearer(ticket.token), self._trust, direct=True)
        await asyncio.to_thread(_download, entry, ticket, path)


def entry_of(master: str, ticket: DownloadTicket) -> str:
    """Return the URL of the HTTP entry on the host of the Master's control address (a Twisted client endpoint)."""
    host = host_of(master) or "127.0.0.1"
    return f"{ticket.scheme}://{f'[{host}]' if ':' in host else host}:{ticket.port}/"


def _download(entry: http.EntryClient, ticket: DownloadTicket, path: Path) -> None:
    with entry.open("GET", ticket.path) as answer, path.open("wb") as file:
        try:
            shutil.copyfileobj(answer, file, CHUNK)
        except (OSError, HTTPException) as error:
            raise Unavailable(f"the download from {entry.url} was interrupted: {error}") from None
        if file.tell() != ticket.size:
            raise Unavailable(f"the download from {entry.url} ended after {file.tell()} of {ticket.size} bytes")
