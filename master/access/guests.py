"""Guests: temporary robots through which consoles and dashboards exchange data with environments.

The environments may be of another user. A guest has a name that no robot may have (`@console_1a2b3c`), and so has
everything that it adds to an environment (`@console_1a2b3c.scan`); all of it is removed with the guest. A guest has
the rights of who opened it: subscribing to topics needs `data.read`, all other data `data.write`, and changes of what
is not its own need the usual rights.
"""

from __future__ import annotations

from master.access import audit, rights
from master.access.users import Users, check_robot_login
from master.graph.state import State
from rce.api.roles import Principal
from rce.errors import InvalidRequest
from rce.protocol import messages as m
from rce.protocol.names import check_tag, is_guest

LISTENING = frozenset({"SubscriberInterface", "PublisherConverter", "PublisherForwarder"})
"""Kinds of interfaces that carry data from an environment to a guest; the others carry it the other way."""


async def check_login(users: Users, principal: Principal, owner: str, robot: str) -> None:
    """Check that somebody may log in as this robot of `owner`.

    Raises:
        Forbidden: Role or key do not allow it.
        NotFound: There is no such owner, or it is not visible.
        InvalidRequest: It is another user's robot, and no guest.
    """
    check_tag(owner, "owner")
    if is_guest(robot):
        rights.check(principal, "data.read", owner, robot=robot)
        await users.get(owner)
        return
    if owner != principal.user:
        raise InvalidRequest("only a guest, whose robotID begins with @, may have another owner", field="owner")
    check_robot_login(principal, robot)


def operation(robot: str, command: m.Command) -> str:
    """Return the operation of a command that this robot, perhaps a guest, gives."""
    if is_guest(robot):
        match command:
            case m.AddInterface(endpoint) if endpoint == robot or _is_made(robot, command):
                return "data.read" if _kind(command) in LISTENING else "data.write"
            case m.RemoveInterface(endpoint, tag) if _is_own(robot, endpoint, tag):
                return "data.read"
            case m.Connect(a, b) | m.Disconnect(a, b) if _is_own(robot, *_sides(a)) and _is_own(robot, *_sides(b)):
                return "data.read"  # the rights of both were checked when they were added
    return rights.COMMANDS[type(command)]


def check_command(principal: Principal, state: State, user: str, robot: str, command: m.Command) -> None:
    """Check the rights of a command on things of `user` that this robot, perhaps a guest, gives.

    Raises:
        Forbidden: Role or key do not allow it.
        NotFound: It is about something that is not visible.
    """
    wanted = operation(robot, command)
    if is_guest(robot) and isinstance(command, m.Connect | m.Disconnect) and wanted not in ("data.read", "data.write"):
        found = _with_robot(state, user, robot, command)
        if found is not None:
            rights.check(principal, found[0], user, robot=found[1])
            return
    if wanted not in ("data.read", "data.write"):
        rights.check_command(principal, state, user, command)
    elif isinstance(command, m.AddInterface) and command.endpointTag != robot:
        rights.check(principal, wanted, user, environment=command.endpointTag)
    else:
        rights.check(principal, wanted, user)


def object_of(user: str, robot: str, command: m.Command) -> str:
    """Return the object of a command for the audit log; for a guest's interface its topic or service."""
    if isinstance(command, m.AddInterface) and is_guest(robot) and _is_made(robot, command):
        return f"{user}/{command.endpointTag}/{command.addr.lstrip('/')}"
    return audit.object_of(user, command)


def is_exempt_from_audit(robot: str, command: m.Command) -> bool:
    """Return whether a guest's command is not worth an audit entry: the topics that it reads and writes are."""
    own = operation(robot, command) in ("data.read", "data.write")
    return own and not (isinstance(command, m.AddInterface) and _is_made(robot, command))


def _with_robot(state: State, user: str, guest: str, command: m.Connect | m.Disconnect) -> tuple[str, str] | None:
    """Return the operation and the robot, if a command joins an interface of this guest with one of a robot."""
    sides = sorted(map(_sides, (command.tagA, command.tagB)), key=lambda side: side[0] != guest)
    (first, tag), (robot, _) = sides
    own = state.interfaces.get(f"{user}/{first}/{tag}")
    if first != guest or own is None or f"{user}/{robot}" not in state.robots:
        return None
    return "data.read" if own.kind in LISTENING else "data.write", robot


def _kind(command: m.AddInterface) -> str:
    return m.ALIASES.get(command.interfaceType, command.interfaceType)


def _is_made(robot: str, command: m.AddInterface) -> bool:
    """Return whether it adds an interface to an environment under a name of this guest."""
    return command.interfaceTag.startswith(f"{robot}.") and _kind(command).endswith("Interface")


def _is_own(robot: str, endpoint: str, tag: str) -> bool:
    return endpoint == robot or tag.startswith(f"{robot}.")


def _sides(tag: str) -> tuple[str, str]:
    endpoint, _, interface = tag.partition("/")
    return endpoint, interface
