"""Transfer of a recording to a store that answers as it likes."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rce.bag.transfer import Broken, StoredFile, Verdict
from rce.errors import LimitExceeded
from rce.net.sockets import bind_unix_socket

FULL = Verdict(LimitExceeded("no more room").info)
Behaviour = Callable[[socket.socket], None]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Callable[[Behaviour], Path]]:
    """Return a function that starts a store, given its behaviour, and returns the path of its socket."""
    listener = bind_unix_socket(tmp_path / "s")
    listener.listen()
    threads: list[threading.Thread] = []

    def start(behave: Behaviour) -> Path:
        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.settimeout(30)
                assert connection.recv(100) == b"box\n"
                behave(connection)

        threads.append(threading.Thread(target=serve))
        threads[0].start()
        return tmp_path / "s"

    yield start
    for thread in threads:
        thread.join(30)
    listener.close()


def test_file_ends_with_the_agreement_of_the_store(store: Callable[[Behaviour], Path]) -> None:
    received = bytearray()

    def behave(connection: socket.socket) -> None:
        connection.sendall(Verdict().line())
        while data := connection.recv(100):
            received.extend(data)
        connection.sendall(Verdict().line())

    file = StoredFile(store(behave), "box")
    file.write(b"some ")
    file.write(b"bytes")
    assert file.tell() == 10
    file.flush()
    file.close()
    file.close()
    assert received == b"some bytes"


@pytest.mark.parametrize(
    ("answer", "error"),
    [(FULL.line(), LimitExceeded), (b"", Broken), (b"nonsense\n", Broken), (b"half a line", Broken)],
)
def test_refusal_and_silence_are_told_apart(
    store: Callable[[Behaviour], Path], answer: bytes, error: type[Exception]
) -> None:
    with pytest.raises(error):
        StoredFile(store(lambda connection: connection.sendall(answer)), "box")


def test_error_in_the_middle_reaches_the_writer(store: Callable[[Behaviour], Path]) -> None:
    def behave(connection: socket.socket) -> None:
        connection.sendall(Verdict().line())
        connection.recv(100)
        connection.sendall(FULL.line())

    file = StoredFile(store(behave), "box")
    with pytest.raises(LimitExceeded):
        file.write(bytes(100_000_000))
    with pytest.raises(Broken):
        file.close()


def test_missing_store_is_broken(tmp_path: Path) -> None:
    with pytest.raises(Broken):
        StoredFile(tmp_path / "nothing", "box")
