"""Sessions with one client of a terminal, without ROS in between."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from rce.protocol import terminal
from rce.protocol.terminal import Request

pytest.importorskip("rclpy", reason="needs the extra `ros`")

LIMIT = 60.0  # seconds until a test gives up


class Client:
    """Client of a session, and the line to it.

    Attributes:
        now: Time that the session sees; tests turn it.
        sent: Frames that the session has sent.
        output: Output of the program so far.
        ended: Whether the test itself has run the session to its end.
        status: Exit status and end of the stream, once the session has sent it.
    """

    def __init__(self) -> None:
        self.now = 100.0
        self.sent: list[bytes] = []
        self.status: tuple[int, int] | None = None
        self.output = b""
        self.ended = False
        self.woken, self._wake = os.pipe()
        self._inbox: list[bytes] = []
        self._received = terminal.ReceiveStream()
        self._typed = terminal.SendStream(self.put)
        self.shell: Any = None

    def put(self, frame: bytes) -> None:
        """Send a frame to the session."""
        self._inbox.append(frame)
        os.write(self._wake, b".")

    def type(self, data: bytes) -> None:
        self._typed.write(data)

    def open(self, command: str) -> None:
        self.put(Request(24, 80, "xterm", command).encode())

    def send(self, frame: bytes) -> None:
        """Receive a frame of the session, which calls this."""
        self.sent.append(frame)
        kind, content = frame[:1], frame[1:]
        if kind == terminal.DATA:
            self.output += self._received.receive(content)
            self.put(self._received.acknowledgement())
        elif kind == terminal.EXIT:
            self.status = terminal.read_exit(content)

    def receive(self) -> list[bytes]:
        """Return the frames for the session, which calls this."""
        os.read(self.woken, 65536)
        found, self._inbox = self._inbox, []
        return found

    def until(self, condition: Callable[[], bool]) -> None:
        """Run the session step by step until a condition holds."""
        deadline = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < deadline, f"the condition does not hold; output: {self.output!r}"
            self.step()

    def step(self) -> None:
        self.shell._wait()
        self.shell._output.tick()
        self.shell._check()

    def close(self) -> None:
        self.shell.over = True
        if not self.ended:
            self.shell.run()
        os.close(self.woken)
        os.close(self._wake)


@pytest.fixture
def client(load: Callable[[str, str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    module = load("rce_shell", "shell")
    client = Client()
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: client.now))
    client.shell = module.Shell(client)
    monkeypatch.setattr(load("rce_shell", "process"), "KILL_AFTER", 0.2)
    yield client
    client.close()


def test_output_and_status_reach_the_client(client: Client) -> None:
    client.open("echo hello; exit 3")
    client.until(lambda: client.status is not None)
    assert client.sent[0] == terminal.READY
    assert client.output == b"hello\r\n"
    assert client.status == (3, len(client.output))


def test_repeated_request_opens_one_terminal(client: Client) -> None:
    for _ in range(3):
        client.open("echo opened; read line")
    client.until(lambda: b"opened" in client.output)
    client.until(lambda: client.sent.count(terminal.READY) == 3)
    assert client.output.count(b"opened") == 1


def test_input_reaches_the_program_once(client: Client) -> None:
    client.open("stty -echo; echo ready; read line; echo got $line")
    client.until(lambda: b"ready" in client.output)
    client.type(b"one\n")
    client.put(terminal.DATA + (0).to_bytes(8, "little") + b"one\n")  # again, as after a lost acknowledgement
    client.until(lambda: client.status is not None)
    assert client.output == b"ready\r\ngot one\r\n"


def test_size_reaches_the_program(client: Client) -> None:
    client.open("read line; stty size")
    client.put(terminal.size_frame(50, 132))
    client.type(b"\n")
    client.until(lambda: client.status is not None)
    assert b"50 132" in client.output


def test_size_before_the_request_is_ignored(client: Client) -> None:
    client.put(terminal.size_frame(50, 132))
    client.open("stty size")
    client.until(lambda: client.status is not None)
    assert client.output == b"24 80\r\n"


def test_session_ends_with_the_hang_up(client: Client) -> None:
    client.open("sleep 1000")
    client.until(lambda: terminal.READY in client.sent)
    assert not client.shell.over
    client.put(terminal.HANG_UP)
    client.until(lambda: client.shell.over)
    client.shell.run()
    client.ended = True
    assert client.shell._process._child.returncode is not None


def test_session_ends_when_the_client_is_silent(client: Client) -> None:
    client.open("sleep 1000")
    client.until(lambda: terminal.READY in client.sent)
    client.now += terminal.CLIENT_TIMEOUT - 1
    client.put(terminal.KEEPALIVE)
    client.step()
    client.now += terminal.CLIENT_TIMEOUT - 1
    client.step()
    assert not client.shell.over
    client.now += 2
    client.step()
    assert client.shell.over


def test_status_is_repeated_until_the_client_hangs_up(client: Client) -> None:
    client.open("exit 3")
    client.until(lambda: client.status is not None)
    client.status = None
    client.now += 1
    client.until(lambda: client.status is not None)
    assert client.status == (3, 0)
    client.put(terminal.HANG_UP)
    client.until(lambda: client.shell.over)


def test_status_waits_for_the_acknowledgement_of_the_output(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client._received, "acknowledgement", lambda: terminal.KEEPALIVE)
    client.open("echo hello")
    client.until(lambda: client.output == b"hello\r\n")
    client.until(lambda: client.shell._process.status == 0)
    client.step()
    assert client.status is None
