"""Guests: robots for a while, by which somebody takes part in the data of environments, their own or another user's.

A console and a dashboard are guests. A guest has a name that no robot may have (`@console_1a2b3c`), so has all that it
makes in an environment (`@console_1a2b3c.scan`), and all of it goes with the guest. It acts by the rights of who has
opened it: `data.read` lets it subscribe to topics, everything else that is data takes `data.write`; what is not its own
it touches by the rights that anybody needs for that.
"""

from __future__ import annotations

from master import audit, rights
from master.effects import Plan
from master.graph import drop_interface, drop_node
from master.records import State
from master.users import Users, must_drive
from rce import messages as m
from rce.errors import InvalidRequest
from rce.names import check_tag, is_guest
from rce.roles import Principal

LISTENING = frozenset({"SubscriberInterface", "PublisherConverter", "PublisherForwarder"})
"""Kinds of interfaces by which data comes out of an environment and to a guest; by the others it goes the other way."""


async def check_login(users: Users, principal: Principal, owner: str, robot: str) -> None:
    """Refuse who may not be this robot of `owner`'s. Forbidden, NotFound, InvalidRequest."""
    check_tag(owner, "owner")
    if is_guest(robot):
        rights.check(principal, "data.read", owner, robot=robot)
        await users.get(owner)
        return
    if owner != principal.user:
        raise InvalidRequest("only a guest, whose robotID begins with @, may have another owner", field="owner")
    must_drive(principal, robot)


def operation(robot: str, command: m.Command) -> str:
    """What a command is that comes by this robot, which may be a guest."""
    if is_guest(robot):
        match command:
            case m.AddInterface(endpoint) if endpoint == robot or _is_made(robot, command):
                return "data.read" if _kind(command) in LISTENING else "data.write"
            case m.RemoveInterface(endpoint, tag) if _is_own(robot, endpoint, tag):
                return "data.read"
            case m.Connect(a, b) | m.Disconnect(a, b) if _is_own(robot, *_sides(a)) and _is_own(robot, *_sides(b)):
                return "data.read"  # what each of the two is good for was asked when it was added
    return rights.COMMANDS[type(command)]


def check_command(principal: Principal, state: State, user: str, robot: str, command: m.Command) -> None:
    """Refuse a command on what is `user`'s that comes by this robot, which may be a guest. Forbidden, NotFound."""
    wanted = operation(robot, command)
    if wanted not in ("data.read", "data.write"):
        rights.check_command(principal, state, user, command)
    elif isinstance(command, m.AddInterface) and command.endpointTag != robot:
        rights.check(principal, wanted, user, environment=command.endpointTag)
    else:
        rights.check(principal, wanted, user)


def object_of(user: str, robot: str, command: m.Command) -> str:
    """As that of the audit log, but for a guest's interface in an environment: the topic or service that it is of."""
    if isinstance(command, m.AddInterface) and is_guest(robot) and _is_made(robot, command):
        return f"{user}/{command.endpointTag}/{command.addr.lstrip('/')}"
    return audit.object_of(user, command)


def is_plumbing(robot: str, command: m.Command) -> bool:
    """Whether it is a guest's affair alone: what others want to know is to which topics it listens or writes."""
    own = operation(robot, command) in ("data.read", "data.write")
    return own and not (isinstance(command, m.AddInterface) and _is_made(robot, command))


def made_by(state: State, name: str) -> Plan:
    """Take what a guest, `user/@tag`, made in environments out of the graph."""
    user, _, robot = name.partition("/")
    plan: Plan = []
    if not is_guest(robot):
        return plan
    for environment in state.environments.by(user):
        for interface in state.interfaces.by(environment.name):
            if interface.spec.tag.startswith(f"{robot}."):
                plan += drop_interface(state, interface)
        for node in state.nodes.by(environment.name):
            if node.spec.tag.startswith(f"{robot}."):
                plan += drop_node(state, node)
    return plan


def _kind(command: m.AddInterface) -> str:
    return m.ALIASES.get(command.interfaceType, command.interfaceType)


def _is_made(robot: str, command: m.AddInterface) -> bool:
    """Whether it is in an environment and has a name of this guest's."""
    return command.interfaceTag.startswith(f"{robot}.") and _kind(command).endswith("Interface")


def _is_own(robot: str, endpoint: str, tag: str) -> bool:
    return endpoint == robot or tag.startswith(f"{robot}.")


def _sides(tag: str) -> tuple[str, str]:
    endpoint, _, interface = tag.partition("/")
    return endpoint, interface
