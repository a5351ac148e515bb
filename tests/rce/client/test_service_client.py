"""Parts that the clients of all services share: credentials and errors."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import ClassVar

import pytest

from rce.client import service_client
from rce.client.service_client import Answer, ServiceClient
from rce.errors import InvalidRequest, NotFound, TimedOut, Unavailable


class SomeClient(ServiceClient):
    prefix = "/some-service"


def test_credentials_are_a_key_or_a_password() -> None:
    assert SomeClient("http://a/", key="rce_1").headers == {"Authorization": "Bearer rce_1"}
    assert SomeClient("http://a/", user="u", password="p").headers == {"Authorization": "Basic dTpw"}
    for given in ({}, {"key": "rce_1", "password": "p"}):
        with pytest.raises(InvalidRequest, match="either a password or an API key"):
            SomeClient("http://a/", **given)


def test_answer_of_another_form_names_the_service() -> None:
    client = SomeClient("http://a/", key="k")
    body = b'{"title": "Not found", "status": 404, "code": "not_found", "detail": "gone"}'
    problem = client.error(Answer(404, http.client.HTTPMessage(), body))
    assert (type(problem), str(problem)) == (NotFound, "gone")
    error = client.error(Answer(502, http.client.HTTPMessage(), b"<html>"))
    assert str(error) == "the some service answered with HTTP status 502"


class Handler(BaseHTTPRequestHandler):
    """A service that announces 10 bytes and sends those of `content`; events end when the connection does."""

    content: ClassVar[bytes] = b""

    def do_GET(self) -> None:
        if self.path.endswith("/lost"):
            body = b'{"title": "Not found", "status": 404, "code": "not_found", "detail": "gone"}'
            self.send_response(404)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
            return
        self.send_response(200)
        if self.path.endswith("/file"):
            self.send_header("Content-Length", "10")
        self.end_headers()
        if self.path != "/some-service/":
            self.wfile.write(self.content)

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def client() -> Iterator[SomeClient]:
    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield SomeClient(f"http://127.0.0.1:{server.server_port}/", key="k")
        server.shutdown()
        thread.join()


def test_download_is_stored_as_a_whole_or_not_at_all(
    client: SomeClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Handler, "content", b"01234")
    with pytest.raises(Unavailable, match="cut off: 5 bytes are missing"):
        client.download("/file", tmp_path / "file")
    with pytest.raises(NotFound, match="gone"):
        client.download("/lost", tmp_path / "file")
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(Handler, "content", b"0123456789")
    client.download("/file", tmp_path / "file")
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("file", b"0123456789")]


def test_events_come_until_the_connection_ends(client: SomeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Handler, "content", b': comment\n\nevent: x\ndata: {"a": 1}\n\ndata: {"a": 2}\n\n')
    assert list(client.events("/events", dict[str, int])) == [{"a": 1}, {"a": 2}]


def test_silence_is_told_apart_from_a_broken_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_client, "TIMEOUT", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = SomeClient(f"http://127.0.0.1:{server.getsockname()[1]}/", key="k")
        monkeypatch.setattr(client, "_locate", lambda: client._base)
        with pytest.raises(TimedOut, match=r"sent nothing for 0\.05 s"):
            list(client.events("/events", int))
    with pytest.raises(Unavailable, match="cannot reach"):
        list(client.events("/events", int))
