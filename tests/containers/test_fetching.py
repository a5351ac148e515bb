"""Downloads from the Master's HTTP entry: its URL, certificates, and interrupted transfers."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from containers.fetching import Fetcher, entry_of
from rce.control.calls.environments import DownloadTicket
from rce.errors import NotFound, Unauthorized, Unavailable
from rce.net.certificates import Authority
from rce.net.tls import Tls
from tests.support.certificates import certify

CONTENT = b"archive" * 100_000


class Entry(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        good = self.headers["Authorization"] == "Bearer token"
        body = CONTENT if good else b'{"title":"","status":401,"detail":"used","code":"unauthorized"}'
        self.send_response(200 if good else 401)
        self.send_header("Content-Type", "application/octet-stream" if good else "application/problem+json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if self.path == "/half" else body)

    def log_message(self, *_: Any) -> None:
        pass


class Link:
    """Control connection as far as a Fetcher uses it."""

    def __init__(self, answer: DownloadTicket | Exception) -> None:
        self.answer = answer

    async def call(self, _: object) -> DownloadTicket:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.fixture
def authority() -> Authority:
    return Authority.make("platform")


@pytest.fixture(params=["http", "https"])
def ticket(request: pytest.FixtureRequest, tmp_path: Path, authority: Authority) -> Iterator[DownloadTicket]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Entry)
    if request.param == "https":
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        own = certify(tmp_path / "master", authority, ["127.0.0.1"])
        context.load_cert_chain(own / "cert.pem", own / "key.pem")
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield DownloadTicket(request.param, server.server_address[1], "/whole", "token", len(CONTENT))
    server.shutdown()
    thread.join()
    server.server_close()


def fetcher(answer: DownloadTicket | Exception, tls: Tls | None, entry: str = "") -> Fetcher:
    return Fetcher(Link(answer), "tcp:127.0.0.1:1", entry, tls)  # type: ignore[arg-type]


@pytest.fixture
def tls(tmp_path: Path, authority: Authority) -> Tls:
    return Tls(certify(tmp_path / "machine", authority, ["127.0.0.1"]))


async def test_archive_is_downloaded(ticket: DownloadTicket, tls: Tls, tmp_path: Path) -> None:
    await fetcher(ticket, tls).fetch("0" * 64, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT
    elsewhere = DownloadTicket(ticket.scheme, 1, ticket.path, ticket.token, ticket.size)
    entry = f"{ticket.scheme}://127.0.0.1:{ticket.port}/"
    await fetcher(elsewhere, tls, entry).fetch("0" * 64, tmp_path / "other")
    assert (tmp_path / "other").read_bytes() == CONTENT


async def test_untrusted_certificate_is_refused(ticket: DownloadTicket, tmp_path: Path) -> None:
    stranger = Tls(certify(tmp_path / "stranger", Authority.make("stranger"), ["127.0.0.1"]))
    for tls in (None, stranger):
        if ticket.scheme == "https":
            with pytest.raises(Unavailable, match="certificate"):
                await fetcher(ticket, tls).fetch("0" * 64, tmp_path / "file")


@pytest.mark.parametrize(
    ("path", "token", "size", "error"),
    [
        ("/half", "token", len(CONTENT), Unavailable),
        ("/whole", "token", len(CONTENT) + 1, Unavailable),
        ("/whole", "used", len(CONTENT), Unauthorized),
    ],
)
async def test_failed_downloads_are_reported(
    ticket: DownloadTicket, tls: Tls, tmp_path: Path, path: str, token: str, size: int, error: type[Exception]
) -> None:
    wrong = DownloadTicket(ticket.scheme, ticket.port, path, token, size)
    with pytest.raises(error):
        await fetcher(wrong, tls).fetch("0" * 64, tmp_path / "file")


async def test_archive_comes_from_the_master_that_leads(ticket: DownloadTicket, tls: Tls, tmp_path: Path) -> None:
    link: Any = Link(ticket)
    entry = f"http://127.0.0.1:1/,{ticket.scheme}://127.0.0.1:{ticket.port}/"
    await Fetcher(link, "tcp:a:1,tcp:b:1", entry, tls).fetch("0" * 64, tmp_path / "file")
    assert (tmp_path / "file").stat().st_size == ticket.size


async def test_unreachable_entry_and_missing_package_are_reported(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="cannot reach"):
        await fetcher(DownloadTicket("http", 1, "/", "", 1), None).fetch("0" * 64, tmp_path / "file")
    with pytest.raises(NotFound):
        await fetcher(NotFound("gone"), None).fetch("0" * 64, tmp_path / "file")


@pytest.mark.parametrize(
    ("master", "expected"),
    [
        ("tcp:127.0.0.1:8080", "https://127.0.0.1:9000/"),
        ("tcp:host=cloud.example:port=8080", "https://cloud.example:9000/"),
        ("tls:cloud.example:8080:trustRoots=/x", "https://cloud.example:9000/"),
        (r"tcp:2001\:db8\:\:1:8080", "https://[2001:db8::1]:9000/"),
        ("unix:/run/rce/control.sock", "https://127.0.0.1:9000/"),
    ],
)
def test_entry_url_is_derived_from_the_ticket(master: str, expected: str) -> None:
    assert entry_of(master, DownloadTicket("https", 9000, "/", "", 1)) == expected
