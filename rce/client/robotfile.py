"""Runner of a robot file, with messages as JSON lines on standard input and output.

Output lines are `{"iTag": …, "type": …, "msg": …}`. Input lines are `{"iTag": …, "msg": …}`: the message is published
or, with a service client, calls the service; the response is written with the `msgID` of the call, if it had one, and
`msg` or `error`. A request to a service that the robot provides is written with a `msgID`, and the input line that
answers it repeats the `msgID` with `msg` or `error`. Blobs, the bytes of raw (Forwarder) interfaces and the data of
packets (of an interface with a codec) are in base64.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import itertools
import logging
import os
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import replace

from rce.client.events import Disconnected, Event, Reconnected
from rce.client.interface import Interface
from rce.client.robot import Robot
from rce.client.robotformat import DeliveryEntry, InterfaceEntry, QosEntry, RobotFile, read
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.topics import Publisher
from rce.client.values import encode
from rce.errors import AlreadyExists, InvalidRequest, NotFound, RceError
from rce.protocol.blobs import Buffer
from rce.protocol.messages import ConnectionEvent, DropEvent, EnvironmentEvent, LimitEvent, NodeEvent, RecorderEvent

log = logging.getLogger("rce.client")

Write = Callable[[bytes], None]


class Line(Struct, frozen=True):
    """Input line."""

    iTag: str
    msg: Any = UNSET
    msgID: str = ""
    error: str = ""


def print_line(line: bytes) -> None:
    """Write a line to standard output at once."""
    sys.stdout.buffer.write(line + b"\n")
    sys.stdout.buffer.flush()


async def run_file(path: Path, *, lines: AsyncIterator[bytes] | None = None, write: Write = print_line) -> None:
    """Run the robot of a file until cancelled, then remove its parameters and destroy its environments.

    Args:
        path: Robot file.
        lines: Input lines in place of those of standard input. The robot keeps running after the last one.
        write: Function that gets each output line.

    Raises:
        InvalidRequest: The file is malformed.
        RceError: A command of the file failed, or the platform refused the robot.
    """
    file = read(path)
    password, key = credentials(path, file)
    async with Robot(file.url, user=file.userID, robot=file.robotID, password=password, key=key) as robot:
        events = robot.events()
        async with AsyncExitStack() as stack:
            runner = Runner(robot, file, write)
            await runner.set_up(stack)
            reader = asyncio.create_task(runner.process(standard_input() if lines is None else lines))
            stack.callback(reader.cancel)
            log.info("robot %s is running", robot.name)
            async for event in events:
                log.info("%s", event_text(event))


def event_text(event: Event) -> str:
    """Return an event as a line for people."""
    match event:
        case EnvironmentEvent(tag, state, reason):
            return f"environment {tag} is {state}" + (f": {reason}" if reason else "")
        case RecorderEvent(tag, recorder, reason):
            return f"recorder {tag}/{recorder} ended: {reason}"
        case NodeEvent(tag, node, status, lines):
            return "\n  ".join([f"node {tag}/{node} ended with status {status}", *lines])
        case DropEvent(interface, count, where):
            return f"interface {interface}: {count} messages were dropped ({where})"
        case ConnectionEvent(one, other, state, reason):
            return f"connection {one} {other} is {state}" + (f": {reason}" if reason else "")
        case LimitEvent(reason):
            return reason
        case Disconnected(reason):
            return f"the connection broke ({reason}); reconnecting"
        case Reconnected(resumed):
            return "connected again" + ("" if resumed else ", with a new session")
    return str(event)


def credentials(path: Path, file: RobotFile) -> tuple[str | None, str | None]:
    """Return password and API key: those of the file, else RCE_KEY or RCE_PASSWORD of the environment.

    Raises:
        InvalidRequest: There are none.
    """
    if file.password is not None or file.key is not None:
        return file.password, file.key
    if key := os.environ.get("RCE_KEY"):
        return None, key
    if password := os.environ.get("RCE_PASSWORD"):
        return password, None
    raise InvalidRequest(f"{path}: no password and no key: set RCE_KEY or RCE_PASSWORD in the environment", field="key")


class Runner:
    """Robot of a file, with its interfaces by tag and the service requests that wait for an answer line."""

    def __init__(self, robot: Robot, file: RobotFile, write: Write) -> None:
        self._robot = robot
        self._file = file
        self._write = write
        self._interfaces: dict[str, tuple[InterfaceEntry, Interface]] = {}
        self._numbers = itertools.count(1)
        self._requests: dict[tuple[str, str], asyncio.Future[Any]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def set_up(self, stack: AsyncExitStack) -> None:
        """Create environments, parameters, nodes, interfaces and connections, in this order; `stack` undoes them.

        What a run that was killed has left in the environments is taken over.
        """
        robot, file = self._robot, self._file
        for container in file.containers:
            with suppress(AlreadyExists):
                await robot.configure(container.command)
            stack.push_async_callback(_clean_up, partial(robot.destroy_environment, container.cTag))
        for parameter in file.parameters:
            await robot.configure(parameter.command)
            undo = partial(robot.delete_parameter, parameter.cTag, parameter.name)
            stack.push_async_callback(_clean_up, undo)
        for node in file.nodes:
            await robot.configure(replace(node.command, existOk=True))
        for entry in file.interfaces:
            if entry.eTag == robot.name and not entry.kind.endswith("Interface"):
                self._interfaces[entry.iTag] = (entry, await self._add(entry))
            else:
                with suppress(AlreadyExists):
                    await robot.configure(entry.command)
        for connection in file.connections:
            with suppress(AlreadyExists):
                await robot.configure(connection.command)

    async def _add(self, entry: InterfaceEntry) -> Interface:
        """Add an interface of the robot; types are named from the cloud's side, so a Subscriber* publishes here."""
        robot, tag, name = self._robot, entry.iTag, entry.iCls
        raw = entry.kind.endswith("Forwarder")
        if entry.kind.startswith("Action"):
            raise InvalidRequest(f"interface {tag}: a robot file has no actions; use rce.client", field="interfaceType")
        if entry.kind.startswith("Subscriber"):
            return await robot.publisher(tag, name, raw=raw or bool(entry.codec), **_options(entry))
        if entry.kind.startswith("Publisher"):
            return await robot.subscriber(
                tag,
                name,
                callback=lambda message: self._print(entry, msg=message),
                raw=raw or bool(entry.codec),
                **_options(entry),
            )
        if (entry.qos, entry.delivery, entry.codec) != (QosEntry(), DeliveryEntry(), ""):
            raise InvalidRequest(f"interface {tag}: qos, delivery and codec are for topics; leave them out")
        if entry.kind.startswith("ServiceProvider"):
            return await robot.service_client(tag, name, raw=raw, format=entry.format)
        return await robot.service_provider(
            tag, name, lambda request: self._request(entry, request), raw=raw, format=entry.format
        )

    def _print(self, entry: InterfaceEntry, **content: Any) -> None:
        self._write(encode({"iTag": entry.iTag, "type": entry.iCls, **_printable(content)}))

    async def _request(self, entry: InterfaceEntry, request: Any) -> Any:
        number = str(next(self._numbers))
        answer = self._requests[entry.iTag, number] = asyncio.get_running_loop().create_future()
        try:
            self._print(entry, msgID=number, msg=request)
            return await answer
        finally:
            del self._requests[entry.iTag, number]

    async def process(self, lines: AsyncIterator[bytes]) -> None:
        """Process input lines; a malformed one is logged and skipped."""
        async for text in lines:
            if not text.strip():
                continue
            try:
                await self._process(msgspec.json.decode(text, type=Line))
            except (RceError, msgspec.DecodeError, UnicodeDecodeError) as error:
                log.error("input line %s: %s", text[:200].decode(errors="replace").strip(), error)

    async def _process(self, line: Line) -> None:
        if line.iTag not in self._interfaces:
            raise NotFound(f"the robot has no interface {line.iTag!r}", field="iTag")
        entry, interface = self._interfaces[line.iTag]
        value = line.msg if line.msg is UNSET else _value_of(line, entry)
        if isinstance(interface, ServiceProvider):
            self._answer(line, value)
        elif value is UNSET:
            raise InvalidRequest("the line has no msg", field="msg")
        elif isinstance(interface, Publisher):
            await interface.publish(value)
        elif isinstance(interface, ServiceClient):
            task = asyncio.create_task(self._call(entry, interface, line.msgID, value))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            raise InvalidRequest(f"interface {line.iTag} receives messages and cannot send any", field="iTag")

    def _answer(self, line: Line, value: Any | UnsetType) -> None:
        answer = self._requests.get((line.iTag, line.msgID))
        if answer is None or answer.done():
            raise NotFound(f"interface {line.iTag} has no pending request with msgID {line.msgID!r}", field="msgID")
        if value is UNSET:
            answer.set_exception(RceError(line.error or "refused"))
        else:
            answer.set_result(value)

    async def _call(self, entry: InterfaceEntry, client: ServiceClient, msg_id: str, value: Any) -> None:
        msg_id_field = {"msgID": msg_id} if msg_id else {}
        try:
            self._print(entry, **msg_id_field, msg=await client.call(value))
        except RceError as error:
            self._print(entry, **msg_id_field, error=str(error))


async def _clean_up(undo: Callable[[], Awaitable[None]]) -> None:
    """Undo one step at the end; log its error so that the remaining steps are undone too."""
    try:
        await undo()
    except RceError as error:
        log.warning("clean-up: %s", error)


def _options(entry: InterfaceEntry) -> dict[str, Any]:
    """Return the options of a topic."""
    return {"format": entry.format, "qos": entry.qos, "delivery": entry.delivery, "codec": entry.codec}


def _value_of(line: Line, entry: InterfaceEntry) -> Any:
    """Return the message of a line; bytes of a raw interface and the data of a packet are in base64."""
    if entry.kind.endswith("Forwarder"):
        return _bytes_of(line.msg, f"msg for the raw interface {line.iTag}")
    if not entry.codec:
        return line.msg
    if not isinstance(line.msg, dict) or "data" not in line.msg:
        raise InvalidRequest(f"msg for interface {line.iTag} with a codec must be a packet, with data", field="msg")
    return {**line.msg, "data": _bytes_of(line.msg["data"], f"msg.data for interface {line.iTag}")}


def _bytes_of(value: Any, what: str) -> bytes:
    try:
        return base64.b64decode(value, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise InvalidRequest(f"{what} must be base64", field="msg") from None


def _printable(value: Any) -> Any:
    if isinstance(value, Buffer):
        return base64.b64encode(value).decode()
    if isinstance(value, dict):
        return {key: _printable(item) for key, item in value.items()}
    if isinstance(value, list) and value and not isinstance(value[0], int | float | str):
        return [_printable(item) for item in value]
    return value


async def standard_input() -> AsyncIterator[bytes]:
    """Yield the lines of standard input, read by a daemon thread: a blocking read must not delay the program's end."""
    queue: asyncio.Queue[bytes] = asyncio.Queue(100)
    loop = asyncio.get_running_loop()

    def read_all() -> None:
        # Not sys.stdin.buffer: at exit Python takes its lock, and aborts while this thread holds it.
        with open(sys.stdin.fileno(), "rb", closefd=False) as lines:
            for line in itertools.chain(lines, [b""]):
                if loop.is_closed():
                    return
                asyncio.run_coroutine_threadsafe(queue.put(line), loop).result()

    threading.Thread(target=read_all, name="standard input", daemon=True).start()
    while line := await queue.get():
        yield line
