"""Fake platform in this process: an entry and a Robot endpoint on loopback, without conversion.

It implements the protocol as far as robots can see it: connections with `iu` status, topics, services, blobs in parts,
acknowledgements, resumption. Environments and nodes are only recorded. With `features=None` it behaves like a server of
the original. The methods at the end inject faults.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

import msgspec
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from rce.client import Robot
from rce.client.address import FEATURES_HEADER
from rce.errors import (
    AlreadyExists,
    ConversionError,
    ErrorInfo,
    InvalidRequest,
    NotConnectable,
    NotConnected,
    NotFound,
    RceError,
)
from rce.protocol.assembler import Assembler, AssemblyResult
from rce.protocol.blobs import Buffer, binary_frames
from rce.protocol.messages import CN_ITEMS, CX_ITEMS, FEATURES, DataMessage, Frame, decode_as, decode_frame
from tests.support.client_contract import Platform

KEY, PASSWORD = "secret-key", "testUser"
PASSWORD_HASH = "5772527c5398c3b1d9999c5a9388823c454126d8a387a32ce461ad7cfc13f656"
OPPOSITE = {"Publisher": "Subscriber", "ServiceClient": "ServiceProvider"}
OPPOSITE |= {value: key for key, value in OPPOSITE.items()}


@dataclass(eq=False)
class Peer:
    """Session of a robot, which outlives its sockets."""

    name: str
    token: str
    features: frozenset[str] = frozenset()
    socket: ServerConnection | None = None
    frames: list[dict[str, Any]] = field(default_factory=list)


class FakePlatform:
    """Platform for tests, to be used as an asynchronous context manager.

    Attributes:
        url: URL of the entry.
        peers: Sessions by robotID.
        interfaces: Interfaces as in addInterfaces, by `endpoint/interface`.
        connections: Pairs of connected interfaces.
        resources: Names of everything that was created and not removed.
        request_paths: Paths of all HTTP requests and handshakes.
        frame_types: Types of all received frames in order; `part` for binary ones.
        entry_body: Response of the entry in place of the endpoint's URL.
        ignores_commands: Commands get no answer.
        incarnation: Incarnation of the Robot endpoint.
    """

    def __init__(self, features: frozenset[str] | None = FEATURES) -> None:
        self.features = features
        self.peers: dict[str, Peer] = {}
        self.interfaces: dict[str, dict[str, Any]] = {}
        self.connections: set[frozenset[str]] = set()
        self.resources: set[tuple[str, ...]] = set()
        self.request_paths: list[str] = []
        self.frame_types: list[str] = []
        self.entry_body = ""
        self.ignores_commands = False
        self.incarnation = "first"
        self._makers: dict[frozenset[str], str] = {}  # robots that asked for connections
        self._waiting: dict[frozenset[str], str] = {}  # connections of others whose end is away
        self._tokens = itertools.count(1)
        self._calls: dict[str, tuple[str, DataMessage]] = {}
        self._taken: dict[tuple[str, str], int] = {}  # highest number by robot and stream
        self._server: Server | None = None
        self._lose_ack = False
        self._refused_message = ""
        self._refusal: tuple[int, str] | None = None

    async def __aenter__(self) -> Self:
        self._server = await serve(
            self._serve,
            "127.0.0.1",
            0,
            process_request=self._check_request,
            process_response=self._grant_features,
            compression=None,
            max_size=None,
            close_timeout=1,
        )
        self.port = self._server.sockets[0].getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/"
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        await self._server.wait_closed()

    def robot(self, name: str = "a", timeout: float = 10) -> Robot:
        """Return a robot with valid credentials, not connected yet."""
        return Robot(self.url, user="testUser", robot=name, password=PASSWORD, timeout=timeout)

    # --- entry and handshake

    def _check_request(self, socket: ServerConnection, request: Request) -> Response | None:
        query = parse_qs(urlsplit(request.path).query)
        self.request_paths.append(request.path)
        if "version" in query:
            return socket.respond(200, self.entry_body or json.dumps({"url": f"ws://127.0.0.1:{self.port}/"}))
        if self._refusal is not None:
            return socket.respond(*self._refusal)
        if query.get("password") != [PASSWORD_HASH] and query.get("key") != [KEY]:
            return socket.respond(401, "unknown user or wrong password")
        peer = self.peers.get(query["robotID"][0])
        if peer is not None and query.get("resume") != [peer.token]:
            return socket.respond(409 if self.features else 400, f"robot {peer.name} is connected already")
        return None

    def _grant_features(self, socket: ServerConnection, request: Request, response: Response) -> None:
        if self.features is not None:
            response.headers[FEATURES_HEADER] = ",".join(sorted(self.features))

    async def _serve(self, socket: ServerConnection) -> None:
        assert socket.request is not None
        query = parse_qs(urlsplit(socket.request.path).query)
        name = query["robotID"][0]
        resumed = name in self.peers
        peer = self.peers.setdefault(name, Peer(name, ""))
        peer.socket, peer.token = socket, f"token{next(self._tokens)}"
        if self.features is not None:
            peer.features = self.features & set(query["features"][0].split(","))
            session = {"topic": "session", "features": sorted(peer.features), "token": peer.token, "resumed": resumed}
            statuses = {
                tag.partition("/")[2]: any(tag in pair for pair in self.connections)
                for tag in self.interfaces
                if tag.startswith(f"{name}/")
            }
            session |= {"grace": 10.0, "interfaces": statuses, "incarnation": self.incarnation}
            await self._send(peer, {"type": "ST", "data": session})
        assembler = Assembler(time.monotonic, parts="parts" in peer.features)
        try:
            async for payload in socket:
                await self._handle(peer, assembler, payload)
        except ConnectionClosed:
            pass
        if peer.socket is socket:
            peer.socket = None
            if socket.close_code == 1000:
                await self._end_session(peer)

    # --- frames

    async def _handle(self, peer: Peer, assembler: Assembler, payload: str | bytes) -> None:
        try:
            if isinstance(payload, bytes):
                self.frame_types.append("part")
                outcome = assembler.add_blob(payload)
            else:
                peer.frames.append(json.loads(payload))
                frame = decode_frame(payload.encode())
                self.frame_types.append(frame.type)
                outcome = assembler.add_frame(frame)
                if frame.type != "DM":
                    await self._command(peer, frame)
                    return
            if outcome.complete is not None:
                await self._data(peer, outcome)
        except RceError as error:
            await self._send_error(peer, None, error)

    async def _command(self, peer: Peer, frame: Frame) -> None:
        if self.ignores_commands:
            return
        data = msgspec.json.decode(frame.data)
        number = frame.id if "ack" in peer.features and isinstance(frame.id, int | str) else None
        try:
            if frame.type == "CC":
                self._add("environment", data["containerTag"])
            elif frame.type == "DC":
                self._remove("environment", data["containerTag"])
                self.resources = {name for name in self.resources if name[0] != data["containerTag"]}
            else:
                for name in CN_ITEMS if frame.type == "CN" else CX_ITEMS:
                    for index, item in enumerate(data.get(name, [])):
                        await self._item(peer, name, index, item)
        except RceError as error:
            await self._send_error(peer, number, error)
            return
        if self._lose_ack:
            self._lose_ack = False
            self.break_socket(peer.name)
        elif number is not None:
            await self._send(peer, {"type": "ST", "id": number, "data": {"topic": "ack"}})

    async def _item(self, peer: Peer, name: str, index: int, item: dict[str, Any]) -> None:
        try:
            if name == "addInterfaces":
                tag = f"{item['endpointTag']}/{item['interfaceTag']}"
                self._add("interface", tag)
                self.interfaces[tag] = item
                await self._restore(tag)
            elif name == "removeInterfaces":
                tag = f"{item['endpointTag']}/{item['interfaceTag']}"
                gone = [pair for pair in self.connections if tag in pair]
                await self._remove_interface(tag)
                for pair in gone:
                    if self._makers[pair] != item["endpointTag"]:
                        await self._connection_event(pair, self._makers[pair], "gone")
            elif name in ("connect", "disconnect"):
                await self._connection(name, item["tagA"], item["tagB"])
                self._makers[frozenset((item["tagA"], item["tagB"]))] = peer.name
            else:
                key = (item["containerTag"], item.get("nodeTag", ""), item.get("recorderTag", ""), item.get("name", ""))
                (self._remove if name in ("removeNodes", "deleteParam", "removeRecorders") else self._add)(*key)
        except RceError as error:
            raise error.with_item(f"{name}[{index}]") from None

    def _add(self, *name: str) -> None:
        if name in self.resources:
            raise AlreadyExists(f"{name} exists")
        self.resources.add(name)

    def _remove(self, *name: str) -> None:
        if name not in self.resources:
            raise NotFound(f"{name} does not exist")
        self.resources.remove(name)

    async def _remove_interface(self, tag: str) -> None:
        self._remove("interface", tag)
        for pair in [pair for pair in self.connections if tag in pair]:
            await self._connection("disconnect", *pair)
        del self.interfaces[tag]

    async def _connection(self, name: str, a: str, b: str) -> None:
        for tag in (a, b):
            if tag not in self.interfaces:
                raise NotFound(f"interface {tag} does not exist")
        pair = frozenset((a, b))
        if (name == "connect") == (pair in self.connections):
            raise (AlreadyExists if name == "connect" else NotFound)(f"connection {a} {b}")
        if OPPOSITE[self._kind(a)] != self._kind(b) or self._class(a) != self._class(b):
            raise NotConnectable(f"{a} and {b} are not a pair")
        before = {tag for each in self.connections for tag in each}
        self.connections ^= {pair}
        after = {tag for each in self.connections for tag in each}
        for tag in sorted(before ^ after):
            await self._status(tag, tag in after)

    async def _status(self, tag: str, status: bool) -> None:
        endpoint, _, interface = tag.partition("/")
        if endpoint in self.peers:
            await self._send(
                self.peers[endpoint], {"type": "ST", "data": {"topic": "iu", "iTag": interface, "status": status}}
            )

    def _kind(self, tag: str) -> str:
        kind: str = self.interfaces[tag]["interfaceType"]
        return next(prefix for prefix in OPPOSITE if kind.startswith(prefix))

    def _class(self, tag: str) -> str:
        name: str = self.interfaces[tag]["className"]
        return name

    # --- data

    async def _data(self, peer: Peer, outcome: AssemblyResult) -> None:
        assert outcome.complete is not None
        frame, blobs = outcome.complete
        message = decode_as(DataMessage, frame.data, "DM")
        tag = f"{peer.name}/{message.iTag}"
        try:
            if not message.stream or self._is_new(peer.name, message):
                await self._route(tag, message, frame, blobs)
        except RceError as error:
            await self._send_error(peer, None if frame.id is msgspec.UNSET else frame.id, error)
            return
        if frame.id is not msgspec.UNSET and "ack" in peer.features:
            await self._send(peer, {"type": "ST", "id": frame.id, "data": {"topic": "ack"}})

    def _is_new(self, robot: str, message: DataMessage) -> bool:
        """Return whether a numbered message has not come before; one without a peer may come again."""
        key, tag = (robot, message.stream), f"{robot}/{message.iTag}"
        new = message.number > self._taken.get(key, 0)
        if new and any(tag in pair for pair in self.connections):
            self._taken[key] = message.number
        return new

    async def _route(self, tag: str, message: DataMessage, frame: Frame, blobs: Mapping[str, Buffer]) -> None:
        if self._refused_message:
            reason, self._refused_message = self._refused_message, ""
            raise ConversionError(reason)
        if tag not in self.interfaces:
            raise NotFound(f"interface {tag} does not exist")
        if message.type != self._class(tag):
            raise InvalidRequest(f"{tag} is of another type")
        data = msgspec.json.decode(frame.data)
        if self._kind(tag) == "ServiceClient":
            caller, call = self._calls.pop(message.msgID)
            if message.error:
                failure = RceError(message.error, iTag=call.iTag, msgID=call.msgID)
                await self._send_error(self.peers[caller.partition("/")[0]], None, failure)
                return
            await self._deliver(caller, data, call.msgID, blobs)
            return
        others = [next(iter(pair - {tag})) for pair in self.connections if tag in pair]
        if not others:
            raise NotConnected(f"{tag} has no peer")
        msg_id = message.msgID if self._kind(tag) == "Subscriber" else f"{next(self._tokens):032x}"
        self._calls[msg_id] = (tag, message)
        for other in others:
            await self._deliver(other, data, msg_id, blobs)

    async def _deliver(self, tag: str, data: dict[str, Any], msg_id: str, blobs: Mapping[str, Buffer]) -> None:
        endpoint, _, interface = tag.partition("/")
        peer = self.peers.get(endpoint)
        if peer is None:
            return  # the other side is an environment
        await self._send(peer, {"type": "DM", "data": {**data, "iTag": interface, "msgID": msg_id}})
        for frame in binary_frames(blobs, "parts" in peer.features):
            if peer.socket is not None:
                await peer.socket.send(frame.join())

    async def _send(self, peer: Peer, frame: dict[str, Any]) -> None:
        if peer.socket is not None:
            with contextlib.suppress(ConnectionClosed):  # it broke just now
                await peer.socket.send(json.dumps(frame))

    async def _send_error(self, peer: Peer, number: int | str | None, error: RceError) -> None:
        frame: dict[str, Any] = {"type": "ER", "data": str(error)}
        if peer.features:
            info: ErrorInfo = error.info
            frame |= {"error": msgspec.to_builtins(info)} | ({"id": number} if number is not None else {})
        await self._send(peer, frame)

    # --- fault injection

    def break_socket(self, robot: str) -> None:
        """Break the robot's socket; its session is kept."""
        socket = self.peers[robot].socket
        assert socket is not None
        self.peers[robot].socket = None
        socket.transport.abort()

    async def end_session(self, robot: str) -> None:
        """Break the robot's socket and end its session."""
        peer = self.peers[robot]
        self.break_socket(robot)
        await self._end_session(peer)

    async def _end_session(self, peer: Peer) -> None:
        self.peers.pop(peer.name, None)
        for tag in [tag for tag in self.interfaces if tag.startswith(f"{peer.name}/")]:
            kept = {pair: self._makers[pair] for pair in self.connections if tag in pair}
            await self._remove_interface(tag)
            for pair, maker in kept.items():
                if maker != peer.name:
                    self._waiting[pair] = maker
                    await self._connection_event(pair, maker, "waiting")
        self._waiting = {pair: maker for pair, maker in self._waiting.items() if maker != peer.name}

    async def _restore(self, tag: str) -> None:
        for pair in [pair for pair in self._waiting if tag in pair and all(each in self.interfaces for each in pair)]:
            maker = self._makers[pair] = self._waiting.pop(pair)
            await self._connection("connect", *pair)
            await self._connection_event(pair, maker, "restored")

    async def _connection_event(self, pair: frozenset[str], robot: str, state: str) -> None:
        if robot in self.peers and "events" in self.peers[robot].features:
            one, other = sorted(pair)
            await self.send_status(robot, topic="connection", tagA=one, tagB=other, state=state)

    def lose_next_ack(self) -> None:
        """Execute the next command, but break the socket before its acknowledgement."""
        self._lose_ack = True

    def refuse_message(self, reason: str) -> None:
        """Refuse the next data message with a ConversionError."""
        self._refused_message = reason

    def refuse_robots(self, status: int, reason: str) -> None:
        """Refuse all handshakes from now on with an HTTP status; 0 accepts them again."""
        self._refusal = (status, reason) if status else None

    async def send_status(self, robot: str, **data: Any) -> None:
        """Send a status frame (ST)."""
        await self._send(self.peers[robot], {"type": "ST", "data": data})

    async def send_raw(self, robot: str, payload: str | bytes) -> None:
        """Send a frame unchanged."""
        socket = self.peers[robot].socket
        assert socket is not None
        await socket.send(payload)


class FakePlatformAdapter(Platform):
    """Fake platform for the client contract."""

    def __init__(self, fake: FakePlatform) -> None:
        self.fake = fake

    def robot(self, name: str) -> Robot:
        return self.fake.robot(name)

    def break_socket(self, robot: str) -> None:
        self.fake.break_socket(robot)

    async def end_session(self, robot: str) -> None:
        await self.fake.end_session(robot)
