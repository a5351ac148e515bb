"""Who may do what: one table, which every door asks (REST, WebSockets of robots, the map service, the feed).

What may not be done to one's own things is Forbidden. What another has does not exist for who may not see it: NotFound,
in the same words whether it is there or not. An operation that a role may not do at all is Forbidden, whosever it is.
"""

from __future__ import annotations

from master.records import State
from rce import messages as m
from rce.errors import Forbidden, NotFound
from rce.names import split_interface
from rce.roles import Principal as Principal
from rce.roles import Scopes

EVERYBODY = "*"  # stands where the owner does, for the things of all users
NOBODY = ""  # the owner of what is the platform's


COLUMNS = ("tied", "robot", "viewer", "user", "operator", "admin")
"""Whoever holds a credential has the rights of one column: that of the role, or `tied` for a key that is tied."""

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
job.read            -      own    own    own    own      own
job.submit          -      own    -      own    own      -
machine.read        -      -      -      -      all      all
machine.invite      -      -      -      -      all      all
metrics.read        -      -      -      -      all      all
"""
RIGHTS: dict[str, dict[str, str]] = {
    operation: dict(zip(COLUMNS, reaches, strict=True))
    for operation, *reaches in map(str.split, _TABLE.strip().splitlines()[1:])
}
"""What each column may do: to its own things, to those of `all` users and the platform's, or to none (`-`)."""

ALWAYS = frozenset({"whoami", "metrics.read"})  # all that a key for metrics is for


def reach(principal: Principal, operation: str) -> str:
    """`own`, `all` or `-`."""
    if principal.scopes.metrics and operation not in ALWAYS:
        return "-"
    return RIGHTS[operation]["tied" if principal.scopes.tied else principal.role]


def check(principal: Principal, operation: str, owner: str, *, robot: str = "", environment: str = "") -> None:
    """Refuse an operation on what is `owner`'s: a user, EVERYBODY, or NOBODY for the platform's own.

    With the robotID or environment tag that it is about, keys that are tied to others are refused too.
    Forbidden, NotFound.
    """
    how_far = reach(principal, operation)
    if how_far == "all":
        return
    if how_far == "-" or owner in (EVERYBODY, NOBODY):
        needed = ("all",) if owner in (EVERYBODY, NOBODY) else ("own", "all")
        able = ", ".join(each for each in COLUMNS if each != "tied" and RIGHTS[operation][each] in needed)
        raise Forbidden(
            f"{_whose(principal)} may not: {operation}; that takes the role {able}",
            operation=operation,
            role=principal.role,
        )
    if owner != principal.user:
        raise NotFound(f"there is no user {owner[:80]}", field="user")
    _check_tie(principal.scopes, operation, robot, environment)


def may(principal: Principal, operation: str, owner: str, *, robot: str = "", environment: str = "") -> bool:
    """Whether `check` lets it pass: for lists, of which each sees what is theirs to see."""
    try:
        check(principal, operation, owner, robot=robot, environment=environment)
    except (Forbidden, NotFound):
        return False
    return True


def _check_tie(scopes: Scopes, operation: str, robot: str, environment: str) -> None:
    if robot and scopes.robot not in ("", robot):
        if operation in ("robot.connect", "data.read"):
            raise Forbidden(f"this key is tied to robotID {scopes.robot}", field="robotID")
        raise NotFound(f"there is no robot {robot[:80]!r}", field="robotID")
    if environment and scopes.environments and environment not in scopes.environments:
        if operation == "environment.create":
            named = ", ".join(scopes.environments)
            raise Forbidden(f"this key is tied to the environments {named}", field="containerTag")
        raise NotFound(f"there is no environment {environment[:80]!r}", field="containerTag")


def _whose(principal: Principal) -> str:
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
    m.AddInterface: "interface.create",
    m.RemoveInterface: "interface.remove",
    m.Connect: "connection.create",
    m.Disconnect: "connection.remove",
}
"""The operation that a command is."""


def check_command(principal: Principal, state: State, user: str, command: m.Command) -> None:
    """Refuse a command on what is `user`'s, by whichever door it comes. Forbidden, NotFound.

    What a tied key may not touch is missing in the words of the graph, and in its order of looking.
    """
    operation = COMMANDS[type(command)]
    check(principal, operation, user)
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
        case _:
            check(principal, operation, user, environment=command.containerTag)


def sees(principal: Principal, state: State, operation: str, user: str, tag: str) -> bool:
    """As `may`, for what a robot or an environment has: `tag` may be either's."""
    if f"{user}/{tag}" in state.robots:
        return may(principal, operation, user, robot=tag)
    return may(principal, operation, user, environment=tag)
