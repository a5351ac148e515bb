"""`env shell`: this side of a terminal in an environment, with the other side played by the test."""

from __future__ import annotations

import asyncio
import os
import pty
import termios
from collections.abc import Iterator
from typing import NamedTuple, cast

import pytest

from rce.cli.lazy import env_shell
from rce.cli.lazy.env_shell import END_OF_INPUT, Input, TerminalClient, raw_terminal, watch_node
from rce.client import Publisher, Subscriber
from rce.client.events import Event
from rce.client.stream import Stream
from rce.errors import Died, StartFailed
from rce.protocol import terminal
from rce.protocol.messages import EnvironmentEvent, NodeEvent


class Ends(NamedTuple):
    """Writing end of standard input, and reading end of standard output."""

    keys: int
    screen: int


@pytest.fixture
def pipes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ends]:
    """Standard input and output that are pipes."""
    stdin, keys = os.pipe()
    screen, stdout = os.pipe()
    monkeypatch.setattr(env_shell, "STDIN", stdin)
    monkeypatch.setattr(env_shell, "STDOUT", stdout)
    yield Ends(keys, screen)
    for each in (stdin, screen, stdout):
        os.close(each)


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Other end of a terminal in raw mode that is standard input."""
    ours, theirs = pty.openpty()
    monkeypatch.setattr(env_shell, "STDIN", theirs)
    with raw_terminal():
        yield ours
    os.close(ours)
    os.close(theirs)


class Node:
    """Terminal node, as a publisher and a subscriber of the client."""

    def __init__(self, answers: bool = True) -> None:
        self.frames: list[bytes] = []
        self.output: Stream[bytes] = Stream(100)
        self.typed = bytearray()
        self._answers = answers
        self._stream = terminal.ReceiveStream()

    def client(self) -> TerminalClient:
        return TerminalClient(cast(Publisher, self), cast(Subscriber, self.output), Input())

    def offer(self, message: bytes, depth: int) -> None:
        frame = terminal.from_cdr(message)
        self.frames.append(frame)
        if frame[:1] == terminal.OPEN and self._answers:
            self.send(terminal.READY)
        if frame[:1] == terminal.DATA:
            self.typed += self._stream.receive(frame[1:])
            if self.typed.endswith(END_OF_INPUT):
                self.exit(7)

    def send(self, frame: bytes) -> None:
        self.output.put(terminal.to_cdr(frame))

    def exit(self, status: int, text: bytes = b"bye") -> None:
        """Print a text and end with this status."""
        terminal.SendStream(self.send).write(text)
        self.send(terminal.exit_frame(status, len(text)))


async def test_input_is_sent_and_output_is_written_until_the_program_exits(pipes: Ends) -> None:
    os.write(pipes.keys, b"~.ls\n")
    os.close(pipes.keys)
    node = Node()
    assert await node.client().run("cat") == 7
    assert node.typed == b"~.ls\n" + END_OF_INPUT
    assert os.read(pipes.screen, 100) == b"bye"
    assert terminal.Request.decode(node.frames[0][1:]).command == "cat"
    assert node.frames[-1] == terminal.HANG_UP


async def test_exit_status_is_awaited_until_all_output_has_arrived(pipes: Ends) -> None:
    node = Node()
    running = asyncio.create_task(node.client().run(""))
    node.send(terminal.READY)
    node.send(terminal.exit_frame(3, 5))
    terminal.SendStream(node.send).write(b"hello")
    node.send(terminal.exit_frame(3, 5))
    assert await running == 3
    assert os.read(pipes.screen, 100) == b"hello"
    os.close(pipes.keys)


async def test_node_that_does_not_answer_is_reported(pipes: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(env_shell, "READY_TIMEOUT", 0.01)
    node = Node(answers=False)
    with pytest.raises(StartFailed, match="did not answer within"):
        await node.client().run("")
    assert node.frames[-1] == terminal.HANG_UP
    os.close(pipes.keys)


async def test_end_of_the_session_is_reported(pipes: Ends) -> None:
    node = Node()
    node.output.end()
    with pytest.raises(Died, match="session has ended"):
        await node.client().run("")
    os.close(pipes.keys)


async def test_escape_hangs_up(keyboard: int) -> None:
    os.write(keyboard, b"~.")
    node = Node()
    assert await node.client().run("") == 128 + 1
    assert node.frames[-1] == terminal.HANG_UP


@pytest.mark.parametrize(
    ("keys", "escaped"),
    [
        (["~."], True),
        (["ls\r~."], True),
        (["~", "."], True),
        (["ls ~."], False),
        (["~.", "x"], False),
        (["~~."], False),
    ],
)
def test_escape_counts_at_the_beginning_of_a_line(keys: list[str], escaped: bool, keyboard: int) -> None:
    stdin = Input()
    for each in keys:
        os.write(keyboard, each.encode())
        assert stdin.read(100) == each.encode()
    assert stdin.escaped is escaped


def test_end_of_a_file_is_sent_once_as_ctrl_d(pipes: Ends) -> None:
    os.close(pipes.keys)
    stdin = Input()
    assert stdin.ready()
    assert stdin.read(10) == END_OF_INPUT
    assert stdin.ended
    assert not stdin.ready()


def test_input_without_keys_is_not_ready(pipes: Ends) -> None:
    assert not Input().ready()
    os.close(pipes.keys)


def test_terminal_is_raw_only_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setattr(env_shell, "STDIN", theirs)
    before = termios.tcgetattr(theirs)
    with raw_terminal():
        assert not termios.tcgetattr(theirs)[3] & (termios.ICANON | termios.ISIG)
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (NodeEvent("brain", "shell", 1, ["no shell"]), "the terminal's node has ended\nno shell"),
        (EnvironmentEvent("brain", "lost", "out of memory"), "environment brain is lost: out of memory"),
        (EnvironmentEvent("brain", "gone"), "environment brain is gone"),
    ],
)
async def test_end_of_node_or_environment_is_reported(event: Event, reason: str) -> None:
    events: Stream[Event] = Stream(10)
    for other in (NodeEvent("brain", "echo", 1), NodeEvent("b2", "shell", 1), EnvironmentEvent("brain", "ready")):
        events.put(other)
    async with watch_node(events, "brain", "shell") as watching:
        events.put(event)
        with pytest.raises(Died) as died:
            await watching
    assert str(died.value).startswith(reason)


async def test_watching_ends_with_its_context() -> None:
    async with watch_node(Stream(1), "brain", "shell") as watching:
        pass
    with pytest.raises(asyncio.CancelledError):
        await watching
