"""Rights: one table for all interfaces (REST, WebSockets of robots, map service, live feed).

An operation that a role may not do at all is Forbidden. Things of another user do not exist for who may not see them:
NotFound, in the same words whether they exist or not.
"""

from __future__ import annotations

from master.graph.state import State
from rce.api.roles import ASSIGNABLE_ROLES, Scopes, UserRole
from rce.api.roles import Principal as Principal
from rce.errors import Forbidden, NotFound
from rce.protocol import messages as m
from rce.protocol.names import split_interface

EVERYBODY = "*"  # as owner: the things of all users
NOBODY = ""  # as owner: the platform itself


COLUMNS = ("tied", "robot", "viewer", "user", "operator", "admin")
"""A credential has the rights of one column: that of its role, or `tied` for a key with scopes."""

_TABLE = """
operation           tied   robot  viewer user   operator admin
whoami              own    own    own    own    own      all
key.read            -      -      own    own    own      all
key.create          -      -      own    own    own      all
key.rotate          -      -      own    own    own      all
key.revoke          -      -      own    own    own      all
password.change     -      -      own    own    own      all
user.read           -      -      own    own    all      all
user.create         -      -      -      -      -        all
user.change         -      -      -      -      -        all
user.remove         -      -      -      -      -        all
limits.read         -      own    own    own    all      all
limits.change       -      -      -      -      -        all
usage.read          -      own    own    own    all      all
audit.read          -      -      own    own    own      all
robot.connect       own    own    -      own    own      -
robot.read          own    own    own    own    all      all
robot.disconnect    -      -      -      own    all      all
environment.read    own    own    own    own    all      all
environment.create  own    own    -      own    all      all
environment.remove  own    own    -      own    all      all
environment.log     own    own    own    own    all      all
node.read           own    own    own    own    all      all
node.create         own    own    -      own    all      all
node.remove         own    own    -      own    all      all
node.log            own    own    own    own    all      all
parameter.read      own    own    own    own    all      all
parameter.set       own    own    -      own    all      all
parameter.remove    own    own    -      own    all      all
recorder.read       own    own    own    own    all      all
recorder.create     own    own    -      own    all      all
recorder.remove     own    own    -      own    all      all
recording.read      -      own    own    own    all      all
recording.upload    -      own    -      own    own      own
recording.remove    -      -      -      own    all      all
interface.read      own    own    own    own    all      all
interface.create    own    own    -      own    all      all
interface.remove    own    own    -      own    all      all
connection.read     own    own    own    own    all      all
connection.create   own    own    -      own    all      all
connection.remove   own    own    -      own    all      all
trace.read          own    own    own    own    all      all
data.read           own    own    own    own    all      all
data.write          own    own    -      own    all      all
feed.read           own    own    own    own    all      all
group.read          -      own    own    own    all      all
package.read        own    own    own    own    all      all
package.push        -      -      -      own    own      all
package.remove      -      -      -      own    own      all
package.share       -      -      -      own    own      all
catalogue.read      own    own    own    own    own      own
catalogue.publish   -      -      -      own    own      all
service.use         own    own    -      own    all      all
service.leave       own    own    -      own    all      all
job.read            -      own    own    own    own      own
job.submit          -      own    -      own    own      -
secret.read         -      -      own    own    own      own
secret.set          -      -      -      own    own      own
secret.remove       -      -      -      own    own      own
secret.use          -      own    -      own    own      own
knowledge.read      own    own    own    own    own      all
knowledge.write     -      own    -      own    own      all
machine.read        -      -      -      -      all      all
machine.invite      -      -      -      -      all      all
machine.remove      -      -      -      -      all      all
metrics.read        -      -      -      -      all      all
"""
RIGHTS: dict[str, dict[str, str]] = {
    operation: dict(zip(COLUMNS, reaches, strict=True))
    for operation, *reaches in map(str.split, _TABLE.strip().splitlines()[1:])
}
"""Reach of each operation by column: `own` things, `all` users' things and the platform's, or none (`-`)."""

ALWAYS = frozenset({"whoami", "metrics.read"})  # the only operations of a key for metrics


def reach(principal: Principal, operation: str) -> str:
    """Return the reach of an operation: `own`, `all` or `-`."""
    if principal.scopes.metrics and operation not in ALWAYS:
        return "-"
    return RIGHTS[operation]["tied" if principal.scopes.tied else principal.role]


def check(principal: Principal, operation: str, owner: str, *, robot: str = "", environment: str = "") -> None:
    """Check an operation on things of `owner`: a user, EVERYBODY, or NOBODY for the platform itself.

    With the robotID or environment tag of its object, scopes of a key are checked, too.

    Raises:
        Forbidden: The role or the key does not allow it.
        NotFound: It is about somebody else's things.
    """
    allowed = reach(principal, operation)
    if allowed == "all":
        return
    if allowed == "-" or owner in (EVERYBODY, NOBODY):
        needed = ("all",) if owner in (EVERYBODY, NOBODY) else ("own", "all")
        able = " or ".join(each for each in COLUMNS if each != "tied" and RIGHTS[operation][each] in needed)
        raise Forbidden(
            f"{_subject(principal)} may not: {operation}; it needs the role {able}",
            operation=operation,
            role=principal.role,
        )
    if owner != principal.user:
        raise NotFound(f"there is no user {owner[:80]}", field="user")
    _check_tie(principal.scopes, operation, robot, environment)


def may(principal: Principal, operation: str, owner: str, *, robot: str = "", environment: str = "") -> bool:
    """Return whether `check` would pass."""
    try:
        check(principal, operation, owner, robot=robot, environment=environment)
    except (Forbidden, NotFound):
        return False
    return True


def check_credential(principal: Principal, role: UserRole, scopes: Scopes) -> None:
    """Check that a credential of this role and these scopes permits no more than the caller's own.

    Raises:
        Forbidden: It permits more.
    """
    if role not in ASSIGNABLE_ROLES[principal.role] or not scopes.within(principal.scopes):
        raise Forbidden(
            f"{_subject(principal)} cannot make, rotate or revoke a key of the role {role} that may do more than it",
            field="role",
        )


def _check_tie(scopes: Scopes, operation: str, robot: str, environment: str) -> None:
    if robot and scopes.robot not in ("", robot):
        if operation in ("robot.connect", "data.read"):
            raise Forbidden(f"this key is tied to robotID {scopes.robot}", field="robotID")
        raise NotFound(f"there is no robot {robot[:80]!r}", field="robotID")
    if environment and scopes.environments and environment not in scopes.environments:
        if operation in ("environment.create", "service.use"):
            named = ", ".join(scopes.environments)
            raise Forbidden(f"this key is tied to the environments {named}", field="containerTag")
        raise NotFound(f"there is no environment {environment[:80]!r}", field="containerTag")


def _subject(principal: Principal) -> str:
    if principal.scopes.metrics:
        return "a key for metrics"
    return "a tied key" if principal.scopes.tied else f"the role {principal.role}"


# --- commands ---------------------------------------------------------------------------------------------------------


COMMANDS: dict[type[m.Command], str] = {
    m.CreateContainer: "environment.create",
    m.DestroyContainer: "environment.remove",
    m.AddNode: "node.create",
    m.RemoveNode: "node.remove",
    m.SetParameter: "parameter.set",
    m.DeleteParameter: "parameter.remove",
    m.AddRecorder: "recorder.create",
    m.RemoveRecorder: "recorder.remove",
    m.AddInterface: "interface.create",
    m.RemoveInterface: "interface.remove",
    m.UseService: "service.use",
    m.LeaveService: "service.leave",
    m.Connect: "connection.create",
    m.Disconnect: "connection.remove",
}
"""The operation of each command."""


def check_command(principal: Principal, state: State, user: str, command: m.Command) -> None:
    """Check a command on things of `user`.

    What a tied key may not touch is reported missing, in the words and the order in which the graph would.

    Raises:
        Forbidden: The role or the key does not allow it.
        NotFound: It is about something that the key does not see.
    """
    operation = COMMANDS[type(command)]
    check(principal, operation, user)
    if isinstance(command, m.CreateContainer) and command.containerData.secrets:
        check(principal, "secret.use", user)  # nodes of the environment read them
    if not principal.scopes.tied:
        return
    match command:
        case m.Connect() | m.Disconnect():
            for field, tag in (("tagA", command.tagA), ("tagB", command.tagB)):
                endpoint, _ = split_interface(tag, field)
                if f"{user}/{tag}" not in state.interfaces or not sees(principal, state, operation, user, endpoint):
                    raise NotFound(f"there is no interface {tag}", field=field)
        case m.RemoveInterface(endpoint, interface):
            if not sees(principal, state, operation, user, endpoint):
                raise NotFound(f"{endpoint[:80]} has no interface {interface[:80]!r}", field="interfaceTag")
        case m.AddInterface(endpoint) if command.interfaceType.endswith("Interface"):
            check(principal, operation, user, environment=endpoint)
        case m.AddInterface(endpoint):
            check(principal, operation, user, robot=endpoint)
        case m.UseService():
            check(principal, operation, user, environment=command.containerTag or command.service.rpartition("/")[2])
        case _:
            check(principal, operation, user, environment=command.containerTag)


def sees(principal: Principal, state: State, operation: str, user: str, tag: str) -> bool:
    """Return whether an operation on things of a robot or an environment (`tag`) is allowed."""
    if f"{user}/{tag}" in state.robots:
        return may(principal, operation, user, robot=tag)
    return may(principal, operation, user, environment=tag)
