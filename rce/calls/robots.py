"""Robots' sessions and commands: between the Master and the Robot endpoints."""

from __future__ import annotations

from typing import get_args

import msgspec
from msgspec import Raw, Struct

from rce.calls.call import Call, Nothing
from rce.errors import ErrorInfo, InvalidRequest
from rce.messages import Command, StatusData

_commands: dict[str, type[Command]] = {kind.__name__: kind for kind in get_args(Command)}


class LoggedIn(Struct, frozen=True):
    """The session; what a resumed one has is bound and routed by the time of this answer. `token` resumes it."""

    token: str
    resumed: bool


class Login(Call[LoggedIn], frozen=True):
    """A robot asks for a session at this Robot endpoint. Unauthorized, InvalidName, AlreadyExists (robotID in use)."""

    user: str
    robot: str
    secret: str  # API key, or SHA-256 hex of the password
    resume: str = ""  # token of the session to take over
    features: list[str] = []
    address: str = ""
    owner: str = ""  # whose robot it is; empty: the user's


class SocketMoved(Call[Nothing], frozen=True):
    """A robot's socket is open, or lost while its session goes on."""

    robot: str
    connected: bool


class Leave(Call[Nothing], frozen=True):
    """A robot's grace time is over: its interfaces and connections go."""

    robot: str


class Execute(Call[Nothing], frozen=True):
    """A robot's command; answered on completion, or with its error.

    `again` marks one that was under way when the Master was lost: what it made already is then not an error.
    """

    robot: str
    kind: str
    item: Raw
    again: bool = False

    @staticmethod
    def of(robot: str, command: Command, again: bool = False) -> Execute:
        """The call for a command. Its kind stands beside it: commands on the robots' wire have no tag of their own."""
        return Execute(robot, type(command).__name__, Raw(msgspec.msgpack.encode(command)), again)

    @property
    def command(self) -> Command:
        """Raises InvalidRequest."""
        if self.kind not in _commands:
            raise InvalidRequest(f"{self.kind[:80]!r} is not a command")
        try:
            return msgspec.msgpack.decode(self.item, type=_commands[self.kind])
        except msgspec.DecodeError as error:
            raise InvalidRequest(f"{self.kind}: {error}") from None


class Definitions(Struct, frozen=True):
    """Type definitions, text of `.msg` and `.srv` files by `pkg/msg/Name` and `pkg/srv/Name`, dependencies included."""

    texts: dict[str, str]


class Describe(Call[Definitions], frozen=True):
    """The definition of a type: a Robot endpoint asks the Master, the Master that user's environments. UnknownType."""

    user: str
    type: str
    service: bool


class Tell(Call[Nothing], frozen=True):
    """Send a status to a robot (Robot endpoint only); `error` goes as an ER."""

    robot: str
    status: StatusData | None = None
    error: ErrorInfo | None = None


class DropRobot(Call[Nothing], frozen=True):
    """End a robot's session and close its socket with the reason."""

    robot: str
    reason: str
