"""Interface between robots' sockets and the endpoint that manages their sessions."""

from __future__ import annotations

from typing import Annotated, Protocol

from msgspec import Meta, Struct

from endpoints.robot.session import RobotSession
from rce.protocol.blobs import Buffer
from rce.protocol.messages import DataMessage


class ServerLimits(Struct, frozen=True):
    """Limits of what one robot may send; sizes in bytes, times in seconds."""

    message: Annotated[int, Meta(ge=1024)] = 64 * 1024 * 1024
    bad_messages: Annotated[int, Meta(ge=0)] = 100  # a minute; 0: no limit
    blobs: Annotated[int, Meta(ge=1)] = 64
    blob_memory: Annotated[int, Meta(ge=1024)] = 256 * 1024 * 1024
    blob_age: Annotated[float, Meta(gt=0)] = 60.0


class SessionManager(Protocol):
    """The endpoint as the WebSocket server sees it."""

    limits: ServerLimits
    grace: float

    async def login(self, request: LoginRequest) -> LoginResult:
        """Authenticate a robot and return its new or resumed session; raise RceError with the reason of a refusal."""

    def data(self, session: RobotSession, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Handle a data message of a robot; errors raised are sent to the robot."""

    def connected(self, session: RobotSession) -> None:
        """Handle that the session has an open socket."""

    def disconnected(self, session: RobotSession) -> None:
        """Handle that the session lost its socket; its grace time begins."""

    def finished(self, session: RobotSession) -> None:
        """End a session at once, because the robot closed its socket normally."""


class LoginRequest(Struct, frozen=True):
    """Parameters of the HTTP request that opens a robot's WebSocket."""

    user: str
    robot: str
    secret: str
    features: frozenset[str]
    resume: str
    compress: bool
    address: str
    owner: str  # the user to whom the robot belongs

    @property
    def name(self) -> str:
        """Name of the robot inside the platform: `owner/robotID`."""
        return f"{self.owner}/{self.robot}"


class LoginResult(Struct, frozen=True):
    """Session of a robot that is logged in."""

    session: RobotSession
    token: str  # with which a later socket resumes the session
    resumed: bool
