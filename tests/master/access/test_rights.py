"""The table of rights: consistency, and the errors of refusals."""

from __future__ import annotations

from typing import get_args

import pytest

from master.access.rights import (
    COLUMNS,
    COMMANDS,
    EVERYBODY,
    NOBODY,
    RIGHTS,
    Principal,
    check,
    check_command,
    check_credential,
    may,
)
from master.graph.commands import CommandContext, execute
from master.graph.records import Environment, EnvironmentOptions, Robot
from master.graph.state import State
from rce.api.roles import ASSIGNABLE_ROLES, Scopes, UserRole
from rce.errors import Forbidden, NotFound, RceError
from rce.protocol import messages as m

TIED = Principal("ann", "robot", "k", scopes=Scopes("r1", ["e1"]))


def test_table_of_rights_is_complete() -> None:
    assert {reach for row in RIGHTS.values() for reach in row.values()} == {"-", "own", "all"}
    assert set(COLUMNS) == {"tied", *get_args(UserRole)}
    assert set(COMMANDS) == set(get_args(m.Command))
    assert set(COMMANDS.values()) <= set(RIGHTS)


@pytest.mark.parametrize("role", get_args(UserRole))
def test_lower_role_has_no_more_rights_than_a_higher_one(role: UserRole) -> None:
    """An administrator is the exception: it cannot be a robot or submit jobs."""
    for lesser in ASSIGNABLE_ROLES[role]:
        for operation, row in RIGHTS.items():
            if not (role == "admin" and operation in ("robot.connect", "job.submit", "job.read")):
                order = ("-", "own", "all")
                assert order.index(row[lesser]) <= order.index(row[role]), (operation, lesser, role)
    assert role in ASSIGNABLE_ROLES[role]


def test_tied_key_has_no_more_rights_than_an_untied_one() -> None:
    assert all(row["tied"] in ("-", row["robot"]) for row in RIGHTS.values())


@pytest.mark.parametrize("operation", RIGHTS)
@pytest.mark.parametrize("role", get_args(UserRole))
def test_things_of_others_are_not_found(role: UserRole, operation: str) -> None:
    """An operation that a role may not do at all is Forbidden, whether the thing exists or not."""
    principal = Principal("ann", role)
    expected = {"-": Forbidden, "own": NotFound, "all": None}[RIGHTS[operation][role]]
    for other in ("bob", "nobody"):
        if expected is None:
            check(principal, operation, other)
            continue
        with pytest.raises(expected) as raised:
            check(principal, operation, other)
        assert other not in str(raised.value).replace(f"no user {other}", "")
    if expected is Forbidden:
        with pytest.raises(Forbidden):
            check(principal, operation, "ann")
    else:
        check(principal, operation, "ann")
    for all_of_them in (EVERYBODY, NOBODY):
        assert may(principal, operation, all_of_them) == (RIGHTS[operation][role] == "all")


def test_metrics_key_reads_only_metrics() -> None:
    principal = Principal("root", "admin", "k", scopes=Scopes(metrics=True))
    assert {operation for operation in RIGHTS if may(principal, operation, "root")} == {"metrics.read", "whoami"}


def furnished(*, hidden: bool) -> State:
    """Things of ann: r1 and e1, to which the key is tied; with `hidden` also r2 and e2."""
    state = State()
    tags = ["1", "2"] if hidden else ["1"]
    for tag in tags:
        state.robots.put(Robot(f"ann/r{tag}", "", ""))
        state.environments.put(Environment(f"ann/e{tag}", EnvironmentOptions(), "0", ""))
        for owner, kind in ((f"r{tag}", "SubscriberConverter"), (f"e{tag}", "PublisherInterface")):
            execute(CommandContext(state, "ann", lambda: "id"), m.AddInterface(owner, "i", kind, "std_msgs/String"))
        execute(CommandContext(state, "ann", lambda: "id"), m.AddNode(f"e{tag}", "n", "p", "e"))
        execute(CommandContext(state, "ann", lambda: "id"), m.SetParameter(f"e{tag}", "p", 1))
        execute(CommandContext(state, "ann", lambda: "id"), m.Connect(f"r{tag}/i", f"e{tag}/i"))
    return state


BEYOND_THE_TIE: list[m.Command] = [
    m.CreateContainer("e2"),
    m.DestroyContainer("e2"),
    m.AddNode("e2", "other", "p", "e"),
    m.RemoveNode("e2", "n"),
    m.SetParameter("e2", "p", 2),
    m.DeleteParameter("e2", "p"),
    m.AddInterface("r2", "new", "SubscriberConverter", "std_msgs/String"),
    m.AddInterface("e2", "new", "PublisherInterface", "std_msgs/String"),
    m.RemoveInterface("r2", "i"),
    m.RemoveInterface("e2", "i"),
    *(kind(one, other) for kind in (m.Connect, m.Disconnect) for one in ("r2/i", "r1/i") for other in ("e2/i", "r2/i")),
]


def attempt(state: State, command: m.Command) -> None:
    check_command(TIED, state, "ann", command)
    execute(CommandContext(state, "ann", lambda: "id"), command)


@pytest.mark.parametrize("command", BEYOND_THE_TIE, ids=repr)
def test_tied_key_does_not_find_the_rest(command: m.Command) -> None:
    said = []
    for hidden in (True, False):
        with pytest.raises(RceError) as raised:
            attempt(furnished(hidden=hidden), command)
        said.append(raised.value.info)
    assert said[0] == said[1]


def test_tied_key_has_all_rights_within_its_scopes() -> None:
    state = furnished(hidden=True)
    for command in (
        m.AddNode("e1", "other", "p", "e"),
        m.SetParameter("e1", "p", 2),
        m.AddInterface("r1", "new", "SubscriberConverter", "std_msgs/String"),
        m.Disconnect("e1/i", "r1/i"),
        m.Connect("r1/i", "e1/i"),
        m.DestroyContainer("e1"),
        m.CreateContainer("e1"),
    ):
        check_command(TIED, state, "ann", command)


def test_secrets_are_used_by_untied_keys_of_their_user_only() -> None:
    """A node of the environment may tell whoever started it."""
    command = m.CreateContainer("e1", m.ContainerData(secrets={"database": "URL"}))
    check_command(Principal("ann", "robot", "k"), State(), "ann", command)
    with pytest.raises(Forbidden, match=r"secret\.use"):
        check_command(TIED, State(), "ann", command)
    with pytest.raises(NotFound):
        check_command(Principal("olga", "operator"), State(), "ann", command)
    check_command(Principal("olga", "operator"), State(), "ann", m.CreateContainer("e1"))


def test_scopes_of_robot_and_environments_are_independent() -> None:
    state = furnished(hidden=True)
    check_command(Principal("ann", "robot", scopes=Scopes("r1")), state, "ann", m.CreateContainer("e3"))
    check_command(Principal("ann", "robot", scopes=Scopes("r1")), state, "ann", m.Connect("r1/i", "e2/i"))
    of_environments = Principal("ann", "robot", scopes=Scopes(environments=["e1"]))
    check(of_environments, "robot.connect", "ann", robot="r2")
    check_command(of_environments, state, "ann", m.Connect("r2/i", "e1/i"))
    with pytest.raises(Forbidden, match="tied to robotID r1"):
        check(TIED, "robot.connect", "ann", robot="r2")


@pytest.mark.parametrize("command", BEYOND_THE_TIE, ids=repr)
def test_viewer_may_give_no_commands(command: m.Command) -> None:
    with pytest.raises(Forbidden):
        check_command(Principal("ann", "viewer"), furnished(hidden=True), "ann", command)


@pytest.mark.parametrize("own", get_args(UserRole))
@pytest.mark.parametrize("other", get_args(UserRole))
def test_credential_may_do_no_more_than_the_callers(own: UserRole, other: UserRole) -> None:
    if other in ASSIGNABLE_ROLES[own]:
        check_credential(Principal("ann", own), other, Scopes())
    else:
        with pytest.raises(Forbidden):
            check_credential(Principal("ann", own), other, Scopes())
