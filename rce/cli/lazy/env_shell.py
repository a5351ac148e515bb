"""Implementation of `env shell`: this terminal, connected to a terminal node in an environment."""

from __future__ import annotations

import argparse
import asyncio
import os
import select
import signal
import sys
import termios
import tty
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

from rce.cli.lazy.guest import Guest
from rce.client import Publisher, Subscriber
from rce.client.events import Event
from rce.client.stream import Stream
from rce.errors import Died, StartFailed
from rce.protocol import terminal
from rce.protocol.messages import EnvironmentEvent, NodeEvent, Qos
from rce.protocol.names import GUEST_PREFIX

STDIN, STDOUT = 0, 1
QUEUE_DEPTH = 1000  # messages
READY_TIMEOUT = 20.0  # seconds
TICK = 0.25  # seconds
READ_SIZE = 4096
ESCAPE = b"~."  # at the beginning of a line, as in ssh
END_OF_INPUT = b"\x04"  # as a terminal sends it for Ctrl-D


class Input:
    """Standard input: a keyboard, a pipe or a file.

    `escaped` is True after `~.` at the beginning of a line typed on a terminal, `ended` after the end of a file.
    """

    def __init__(self) -> None:
        self.escaped = False
        self.ended = False
        self._tty = os.isatty(STDIN)
        self._tail = b"\r"

    def ready(self) -> bool:
        """Return True if `read` does not block; its end is read, too."""
        return not self.ended and bool(select.select([STDIN], [], [], 0)[0])

    def read(self, count: int) -> bytes:
        """Read at most `count` bytes; at the end return END_OF_INPUT."""
        data = os.read(STDIN, count)
        if not data:
            self.ended = True
            return END_OF_INPUT
        if self._tty:
            self._tail = (self._tail + data)[-3:]
            self.escaped = self._tail in (b"\r" + ESCAPE, b"\n" + ESCAPE)
        return data


class TerminalClient:
    """Client of a terminal node, by the protocol of `rce.protocol.terminal`."""

    def __init__(self, publisher: Publisher, subscriber: Subscriber, stdin: Input) -> None:
        self._publisher = publisher
        self._subscriber = subscriber
        self._stdin = stdin
        self._outgoing = terminal.SendStream(self._send)
        self._incoming = terminal.ReceiveStream()
        self._ready = asyncio.Event()

    def _send(self, frame: bytes) -> None:
        self._publisher.offer(terminal.to_cdr(frame), QUEUE_DEPTH)

    async def run(self, command: str) -> int:
        """Run a command, or an interactive shell if it is empty, and return its exit status.

        Raises:
            StartFailed: The node did not answer in time.
            Died: The console's session ended.
        """
        receiving = asyncio.create_task(self._receive())
        others: list[asyncio.Task[None]] = []
        try:
            await self._open(command, receiving)
            others = [asyncio.create_task(self._send_input()), asyncio.create_task(self._tick())]
            asyncio.get_running_loop().add_signal_handler(signal.SIGWINCH, self._send_size)
            await asyncio.wait([receiving, *others], return_when=asyncio.FIRST_COMPLETED)
            for task in others:
                if task.done():
                    task.result()  # raises its error
            return await receiving if receiving.done() else 128 + signal.SIGHUP
        finally:
            self._send(terminal.HANG_UP)
            receiving.cancel()
            for task in others:
                task.cancel()

    async def _open(self, command: str, receiving: asyncio.Task[int]) -> None:
        request = terminal.Request(*_terminal_size(), os.environ.get("TERM", "dumb"), command)
        try:
            async with asyncio.timeout(READY_TIMEOUT):
                while not self._ready.is_set() and not receiving.done():
                    self._send(request.encode())
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self._ready.wait(), TICK)
        except TimeoutError:
            raise StartFailed(f"the terminal's node did not answer within {READY_TIMEOUT:g} s") from None

    async def _receive(self) -> int:
        """Write the node's output until its exit status arrives."""
        async for message in self._subscriber:
            frame = terminal.from_cdr(message)
            kind, content = frame[:1], frame[1:]
            if kind == terminal.DATA:
                await asyncio.to_thread(_write, self._incoming.receive(content))
                self._send(self._incoming.acknowledgement())
            elif kind == terminal.ACK:
                self._outgoing.acknowledged(content)
            elif kind == terminal.READY:
                self._ready.set()
            elif kind == terminal.EXIT:
                status, end = terminal.read_exit(content)
                if self._incoming.end == end:
                    return status
        raise Died("the console's session has ended")

    async def _send_input(self) -> None:
        loop = asyncio.get_running_loop()
        while not self._stdin.escaped:
            await _wait_readable(loop, self._stdin)
            if room := self._outgoing.room:
                self._outgoing.write(self._stdin.read(min(room, READ_SIZE)))
            else:
                await asyncio.sleep(TICK)

    async def _tick(self) -> None:
        while True:
            for _ in range(int(terminal.KEEPALIVE_INTERVAL / TICK)):
                self._outgoing.tick()
                await asyncio.sleep(TICK)
            self._send(terminal.KEEPALIVE)

    def _send_size(self) -> None:
        self._send(terminal.size_frame(*_terminal_size()))


async def shell(guest: Guest, args: argparse.Namespace) -> int:
    """Run a terminal in the environment and return the exit status of its program."""
    qos = Qos("reliable", "volatile", depth=QUEUE_DEPTH)
    prefix = f"/rce_shell/{guest.robot.name.removeprefix(GUEST_PREFIX)}"
    robot, events = guest.robot, guest.robot.events()
    tag = await guest.add_node("shell", "rce_shell", "shell", prefix)
    node_input = await guest.add_interface("input", "PublisherInterface", terminal.MESSAGE, f"{prefix}/input", qos)
    output = await guest.add_interface("output", "SubscriberInterface", terminal.MESSAGE, f"{prefix}/output", qos)
    publisher = await robot.publisher("input", terminal.MESSAGE, to=node_input, raw=True, qos=qos)
    subscriber = await robot.subscriber("output", terminal.MESSAGE, to=output, raw=True, qos=qos, depth=QUEUE_DEPTH)
    client = TerminalClient(publisher, subscriber, Input())
    with raw_terminal():
        async with watch_node(events, guest.environment, tag) as watching:
            running = asyncio.create_task(client.run(" ".join(args.command)))
            await asyncio.wait([running, watching], return_when=asyncio.FIRST_COMPLETED)
            if not running.done():
                running.cancel()
                watching.result()
            return await running


@asynccontextmanager
async def watch_node(events: Stream[Event], environment: str, node: str) -> AsyncIterator[asyncio.Task[None]]:
    """Run a task that raises Died when the node or the environment ends."""

    async def watch() -> None:
        async for event in events:
            match event:
                case NodeEvent(containerTag=tag, nodeTag=name, lines=lines) if (tag, name) == (environment, node):
                    raise Died("\n".join(["the terminal's node has ended", *lines]))
                case EnvironmentEvent(containerTag=tag, state="lost" | "gone") if tag == environment:
                    raise Died(f"environment {environment} is {event.state}: {event.reason}")

    task = asyncio.create_task(watch())
    try:
        yield task
    finally:
        task.cancel()


@contextmanager
def raw_terminal() -> Iterator[None]:
    """Set the terminal to raw mode, so that keys like Ctrl-C are sent, and restore it afterwards."""
    if not os.isatty(STDIN):
        yield
        return
    before = termios.tcgetattr(STDIN)
    tty.setraw(STDIN, termios.TCSADRAIN)  # keeps what was typed already
    try:
        yield
    finally:
        termios.tcsetattr(STDIN, termios.TCSADRAIN, before)
        sys.stdout.flush()


async def _wait_readable(loop: asyncio.AbstractEventLoop, stdin: Input) -> None:
    """Wait until there is input; never return after its end."""
    ready = asyncio.Event()
    if stdin.ended:
        await ready.wait()
    if stdin.ready():
        return
    loop.add_reader(STDIN, ready.set)  # epoll refuses files, but these are always ready
    try:
        await ready.wait()
    finally:
        loop.remove_reader(STDIN)


def _terminal_size() -> tuple[int, int]:
    """Return the rows and columns of the terminal."""
    try:
        size = os.get_terminal_size(STDOUT)
    except OSError:
        return 24, 80
    return size.lines, size.columns


def _write(data: bytes) -> None:
    while data:
        data = data[os.write(STDOUT, data) :]
