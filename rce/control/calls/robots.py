"""Calls between the Master and the Robot endpoints about the sessions and commands of robots."""

from __future__ import annotations

from typing import Literal, get_args

import msgspec
from msgspec import Raw, Struct

from rce.control.calls.call import Call, Nothing
from rce.control.calls.watching import Asset, RosGraph
from rce.errors import MALFORMED, ErrorInfo, InvalidRequest, RceError
from rce.protocol.messages import Command, StatusData, UsedService

_commands: dict[str, type[Command]] = {kind.__name__: kind for kind in get_args(Command)}


class LoggedIn(Struct, frozen=True):
    """Session of a robot.

    `token` resumes it later. The interfaces and routes of a resumed session exist at its endpoint before this answer.
    """

    token: str
    resumed: bool


class Login(Call[LoggedIn], frozen=True):
    """Log a robot in at this Robot endpoint.

    Raises Unauthorized, InvalidName, AlreadyExists (robotID in use).
    """

    user: str
    robot: str
    secret: str  # API key, or SHA-256 hex of the password
    resume: str = ""  # token of the session to resume
    features: list[str] = []
    address: str = ""
    owner: str = ""  # user who owns the robot; empty for `user`


class SocketStatus(Call[Nothing], frozen=True):
    """Report that a robot's socket was lost while its session continues, or that it has one again."""

    robot: str
    connected: bool


class SessionExpired(Call[Nothing], frozen=True):
    """Report that the grace period of a robot is over: its session ends, with its interfaces and connections."""

    robot: str


class Executed(Struct, frozen=True):
    """Result of `Execute`: the errors of the commands that failed, and the services used, by their positions."""

    failed: dict[int, ErrorInfo] = {}
    services: dict[int, UsedService] = {}

    def raise_first_error(self) -> None:
        """Raise the error of the first command that failed, if there is one.

        Raises:
            RceError: That error.
        """
        if self.failed:
            raise RceError.from_info(self.failed[min(self.failed)])


class PackedCommand(Struct, frozen=True):
    """One command of a robot. `kind` names its type, because the structs of commands have no tag."""

    kind: str
    item: Raw

    def unpack(self) -> Command:
        """Decode the command.

        Raises:
            InvalidRequest: It is malformed.
        """
        if self.kind not in _commands:
            raise InvalidRequest(f"{self.kind[:80]!r} is not a command")
        try:
            return msgspec.msgpack.decode(self.item, type=_commands[self.kind])
        except MALFORMED as error:
            raise InvalidRequest(f"{self.kind}: {error}") from None


class Execute(Call[Executed], frozen=True):
    """Execute the commands of a robot's frame in their order; answered when all are complete or have failed.

    `again` marks a retry of commands that were in progress when the Master was lost: it is not an error if the object
    of a command exists already.
    """

    timeout = 300.0  # longer than the Master takes for any command
    robot: str
    commands: list[PackedCommand]
    again: bool = False

    @staticmethod
    def of(robot: str, *commands: Command, again: bool = False) -> Execute:
        """Make the call for commands of a robot, `userID/robotID`."""
        packed = [PackedCommand(type(each).__name__, Raw(msgspec.msgpack.encode(each))) for each in commands]
        return Execute(robot, packed, again)


Sort = Literal["msg", "srv", "action"]
"""Sort of a type; also the directory of its definition and the suffix of that file."""


class Definitions(Struct, frozen=True):
    """Type definitions with their dependencies: text of the file by its name, as `pkg/msg/Name` or `pkg/srv/Name`."""

    texts: dict[str, str]


class DescribeType(Call[Definitions], frozen=True):
    """Request the definition of a type: a Robot endpoint from the Master, the Master from an environment of the user.

    Raises UnknownType.
    """

    timeout = 75.0  # an environment may have to start
    user: str
    type: str
    sort: Sort


class ReadGraphFor(Call[RosGraph], frozen=True):
    """Read the ROS graph of an environment of the robot's owner, if who opened the robot's session may see it.

    Raises NotFound, Forbidden, Unavailable.
    """

    robot: str
    environment: str


class ReadAssetFor(Call[Asset], frozen=True):
    """Read a piece of a package's file in an environment, with the rights of ReadGraphFor."""

    robot: str
    environment: str
    package: str
    path: str
    offset: int = 0


class RobotInterfaceName(Struct, frozen=True):
    """Interface of a robot with a session: robotID, tag, kind as `SubscriberConverter`, and type."""

    robot: str
    tag: str
    kind: str
    type: str


class RobotInterfaces(Struct, frozen=True):
    """Interfaces of robots, sorted by their names."""

    interfaces: list[RobotInterfaceName]


class ReadRobotsFor(Call[RobotInterfaces], frozen=True):
    """Read the interfaces of the robots of the robot's owner that who opened the robot's session may see.

    Raises NotFound.
    """

    robot: str


class SendStatus(Call[Nothing], frozen=True):
    """Send a status (ST) or an error (ER) to robots of this Robot endpoint."""

    robots: list[str]
    status: StatusData | None = None
    error: ErrorInfo | None = None


class DropRobot(Call[Nothing], frozen=True):
    """End a robot's session and close its socket with this reason."""

    robot: str
    reason: str
