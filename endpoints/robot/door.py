"""Between a robot's socket and the endpoint: what a robot says when it comes, and what the endpoint does for it."""

from __future__ import annotations

from typing import Annotated, Protocol

from msgspec import Meta, Struct

from endpoints.robot.session import Session
from rce.blobs import Buffer
from rce.messages import DataMessage


class ServerLimits(Struct, frozen=True):
    """What one robot may send."""

    message: Annotated[int, Meta(ge=1024)] = 64 * 1024 * 1024
    bad_messages: Annotated[int, Meta(ge=0)] = 100  # a minute; 0: no limit
    blobs: Annotated[int, Meta(ge=1)] = 64
    blob_memory: Annotated[int, Meta(ge=1024)] = 256 * 1024 * 1024
    blob_age: Annotated[float, Meta(gt=0)] = 60.0


class Door(Protocol):
    """What the server needs of the endpoint."""

    limits: ServerLimits
    grace: float

    async def login(self, greeting: Greeting) -> Admitted:
        """A session for a robot that has proved who it is; raises why not."""

    def data(self, session: Session, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Take a data message of the robot; raises what the robot shall hear."""

    def connected(self, session: Session) -> None:
        """The session has a socket, which is open."""

    def disconnected(self, session: Session) -> None:
        """The session has lost its socket: its grace time begins."""

    def finished(self, session: Session) -> None:
        """The robot has said goodbye: its session ends now."""


class Greeting(Struct, frozen=True):
    """What a robot says in the request that opens its WebSocket."""

    user: str
    robot: str
    secret: str
    features: frozenset[str]
    resume: str
    compress: bool
    address: str
    owner: str  # the user whose robot it is

    @property
    def name(self) -> str:
        """`owner/robotID`, as everywhere behind the door."""
        return f"{self.owner}/{self.robot}"


class Admitted(Struct, frozen=True):
    """The answer to it."""

    session: Session
    token: str
    resumed: bool
