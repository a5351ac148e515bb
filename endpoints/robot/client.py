"""Clients behind WebSockets: what a socket of the server serves. Here: a robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from msgspec import Struct
from twisted.logger import Logger

from endpoints.robot.endpoint import LoginResult, RobotEndpoint
from endpoints.robot.frame_receiver import FrameReceiver
from endpoints.robot.handshake import Request, parse_login
from endpoints.robot.session import Socket

log = Logger()


class Accepted(Struct, frozen=True):
    """Answer to a handshake: `compress` is true if messages may be compressed."""

    compress: bool = False
    headers: dict[str, str] = {}
    subprotocol: str = ""


class Client(Protocol):
    """A client as its WebSocket sees it."""

    @property
    def user(self) -> str:
        """The user whose turns it takes."""

    @property
    def features(self) -> frozenset[str]:
        """Features that it asked for, which say how a refusal is reported."""

    async def login(self, request: Request) -> Accepted:
        """Log in; raise RceError to refuse the handshake."""

    def abandoned(self) -> None:
        """Handle that the connection was lost after the login, before it was open."""

    def opened(self, socket: Socket) -> None:
        """Begin to exchange messages."""

    def closed(self, normal: bool, reason: str) -> None:
        """Handle that the open socket is closed; `normal` is true for a normal closure by the client."""

    def text(self, payload: bytes) -> None:
        """Handle a text message."""

    def binary(self, *fragments: bytes) -> None:
        """Handle a binary message, which came in one or more fragments."""

    def sweep(self) -> None:
        """Forget what did not come in time; called every few seconds."""

    def hold(self) -> None:
        """Keep messages to the client: its socket is full, or closing."""

    def proceed(self) -> None:
        """Send messages again."""


Choose = Callable[[str], Client]
"""Returns the client for the path of a request."""


class RobotClient:
    """A robot."""

    def __init__(self, endpoint: RobotEndpoint) -> None:
        self.user = ""
        self.features: frozenset[str] = frozenset()
        self._endpoint = endpoint
        self._login: LoginResult
        self._socket: Socket | None = None

    async def login(self, request: Request) -> Accepted:
        """Log the robot in."""
        login = parse_login(request)
        self.features = login.features
        self._login = await self._endpoint.login(login)
        session = self._login.session
        self.user = session.name.partition("/")[0]
        headers = {"RCE-Features": ",".join(sorted(session.features))} if session.features else {}
        return Accepted(login.compress, headers)

    def abandoned(self) -> None:
        """Start the grace time of the session."""
        if self._login.session.socket is None:
            self._endpoint.disconnected(self._login.session)

    def opened(self, socket: Socket) -> None:
        """Attach the socket to its session."""
        session = self._login.session
        self._socket = socket
        self._receiver = FrameReceiver(session, self._endpoint.limits, self._endpoint.data, socket.end)
        previous = session.socket
        if previous is not None:
            previous.end("the robot has a newer connection")
        session.attach(socket, self._login.token, self._login.resumed, self._endpoint.grace)
        self._endpoint.connected(session)

    def closed(self, normal: bool, reason: str) -> None:
        """Detach the socket from its session; a normal closure ends the session of a client with features."""
        session = self._login.session
        if self._socket is None or not session.detach(self._socket):
            return
        if normal and session.features:
            self._endpoint.finished(session)  # clients of the original protocol always have the grace time
            return
        log.info("robot {robot} lost its socket: {reason}", robot=session.name, reason=reason)
        self._endpoint.disconnected(session)

    def text(self, payload: bytes) -> None:
        """Handle a frame."""
        self._receiver.text(payload)

    def binary(self, *fragments: bytes) -> None:
        """Handle a blob or a part of one."""
        self._receiver.binary(*fragments)

    def sweep(self) -> None:
        """Reject frames and blobs whose rest did not come in time."""
        self._receiver.sweep()

    def hold(self) -> None:
        """Keep messages for the robot in its outbox."""
        if self._login.session.socket is self._socket:
            self._login.session.outbox.pause()

    def proceed(self) -> None:
        """Let messages leave the outbox."""
        if self._login.session.socket is self._socket:
            self._login.session.outbox.resume()
