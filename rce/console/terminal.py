"""`env shell`: this terminal, in an environment."""

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

from rce import terminal
from rce.client import Publisher, Subscriber
from rce.client.events import Event
from rce.client.stream import Stream
from rce.console.part import Part
from rce.errors import Died, StartFailed
from rce.messages import EnvironmentEvent, NodeEvent, Qos
from rce.names import GUEST

STDIN, STDOUT = 0, 1
DEPTH = 1000
PATIENCE = 20.0  # seconds for the node to answer
TICK = 0.25
READ = 4096
LEAVE = b"~."  # at the beginning of a line, as in other remote shells
END_OF_INPUT = b"\x04"  # what a terminal sends for Ctrl-D


class Keyboard:
    """What is typed, or comes by a pipe or a file; `leaving` after `~.` at the beginning of a line of a terminal."""

    def __init__(self) -> None:
        self.leaving = False
        self.over = False
        self._tty = os.isatty(STDIN)
        self._tail = b"\r"

    def ready(self) -> bool:
        """Also at the end, which is read as well."""
        return not self.over and bool(select.select([STDIN], [], [], 0)[0])

    def read(self, count: int) -> bytes:
        data = os.read(STDIN, count)
        if not data:
            self.over = True
            return END_OF_INPUT
        if self._tty:
            self._tail = (self._tail + data)[-3:]
            self.leaving = self._tail in (b"\r" + LEAVE, b"\n" + LEAVE)
        return data


class Client:
    """The conversation with the node."""

    def __init__(self, publisher: Publisher, subscriber: Subscriber, keyboard: Keyboard) -> None:
        self._publisher = publisher
        self._subscriber = subscriber
        self._keyboard = keyboard
        self._outgoing = terminal.Outgoing(self._send)
        self._incoming = terminal.Incoming()
        self._heard = asyncio.Event()  # READY

    def _send(self, frame: bytes) -> None:
        self._publisher.offer(terminal.to_cdr(frame), DEPTH)

    async def run(self, command: str) -> int:
        """The exit status. StartFailed, and what ends a robot."""
        answering = asyncio.create_task(self._answer())
        others: list[asyncio.Task[None]] = []
        try:
            await self._open(command, answering)
            others = [asyncio.create_task(self._type()), asyncio.create_task(self._tick())]
            asyncio.get_running_loop().add_signal_handler(signal.SIGWINCH, self._resized)
            await asyncio.wait([answering, *others], return_when=asyncio.FIRST_COMPLETED)
            for task in others:
                if task.done():
                    task.result()  # its error, if it had one
            return await answering if answering.done() else 128 + signal.SIGHUP
        finally:
            self._send(terminal.BYE)
            answering.cancel()
            for task in others:
                task.cancel()

    async def _open(self, command: str, answering: asyncio.Task[int]) -> None:
        request = terminal.Request(*_size(), os.environ.get("TERM", "dumb"), command)
        try:
            async with asyncio.timeout(PATIENCE):
                while not self._heard.is_set() and not answering.done():
                    self._send(request.encode())
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self._heard.wait(), TICK)
        except TimeoutError:
            raise StartFailed(f"the terminal's node did not answer within {PATIENCE:g} s") from None

    async def _answer(self) -> int:
        """Write what comes until the exit status does."""
        async for message in self._subscriber:
            frame = terminal.from_cdr(message)
            kind, content = frame[:1], frame[1:]
            if kind == terminal.DATA:
                await asyncio.to_thread(_write, self._incoming.take(content))
                self._send(self._incoming.acknowledgement())
            elif kind == terminal.TAKEN:
                self._outgoing.taken(content)
            elif kind == terminal.READY:
                self._heard.set()
            elif kind == terminal.EXIT:
                status, end = terminal.read_exit(content)
                if self._incoming.end == end:
                    return status
        raise Died("the session of this console has ended")

    async def _type(self) -> None:
        """Send what is typed, until `~.`."""
        loop = asyncio.get_running_loop()
        while not self._keyboard.leaving:
            await _readable(loop, self._keyboard)
            if room := self._outgoing.room:
                self._outgoing.put(self._keyboard.read(min(room, READ)))
            else:
                await asyncio.sleep(TICK)

    async def _tick(self) -> None:
        while True:
            for _ in range(int(terminal.HERE_EVERY / TICK)):
                self._outgoing.tick()
                await asyncio.sleep(TICK)
            self._send(terminal.HERE)

    def _resized(self) -> None:
        self._send(terminal.size_frame(*_size()))


async def shell(part: Part, words: argparse.Namespace) -> int:
    """A terminal in the environment; the exit status of what ran there."""
    qos = Qos("reliable", "volatile", depth=DEPTH)
    prefix = f"/rce_shell/{part.robot.name.removeprefix(GUEST)}"
    events = part.robot.events()
    tag = await part.node("shell", "rce_shell", "shell", prefix)
    inside = await part.interface("input", "PublisherInterface", terminal.MESSAGE, f"{prefix}/input", qos)
    outside = await part.interface("output", "SubscriberInterface", terminal.MESSAGE, f"{prefix}/output", qos)
    publisher = await part.robot.publisher("input", terminal.MESSAGE, to=inside, raw=True, qos=qos)
    subscriber = await part.robot.subscriber("output", terminal.MESSAGE, to=outside, raw=True, qos=qos, depth=DEPTH)
    keyboard = Keyboard()
    with raw_terminal():
        async with watched(events, part.environment, tag) as watch:
            running = asyncio.create_task(Client(publisher, subscriber, keyboard).run(" ".join(words.command)))
            await asyncio.wait([running, watch], return_when=asyncio.FIRST_COMPLETED)
            if not running.done():
                running.cancel()
                watch.result()
            return await running


@asynccontextmanager
async def watched(events: Stream[Event], environment: str, node: str) -> AsyncIterator[asyncio.Task[None]]:
    """A task that fails when the node or the environment goes. Died."""

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
    """Every key goes to the other side, Ctrl-C too; as it was afterwards."""
    if not os.isatty(STDIN):
        yield
        return
    before = termios.tcgetattr(STDIN)
    tty.setraw(STDIN, termios.TCSADRAIN)  # what was typed before is kept
    try:
        yield
    finally:
        termios.tcsetattr(STDIN, termios.TCSADRAIN, before)
        sys.stdout.flush()


async def _readable(loop: asyncio.AbstractEventLoop, keyboard: Keyboard) -> None:
    """Wait for something to read; for ever at the end."""
    ready = asyncio.Event()
    if keyboard.over:
        await ready.wait()
    if keyboard.ready():
        return
    loop.add_reader(STDIN, ready.set)  # a file is always ready, and did not come here
    try:
        await ready.wait()
    finally:
        loop.remove_reader(STDIN)


def _size() -> tuple[int, int]:
    """Rows and columns."""
    try:
        size = os.get_terminal_size(STDOUT)
    except OSError:
        return 24, 80
    return size.lines, size.columns


def _write(data: bytes) -> None:
    while data:
        data = data[os.write(STDOUT, data) :]
