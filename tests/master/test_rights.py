"""The table of rights: what it says hangs together, and what is refused looks as it must."""

from __future__ import annotations

from typing import get_args

import pytest

from master.graph import execute
from master.records import Environment, Robot, State
from master.rights import COLUMNS, COMMANDS, EVERYBODY, NOBODY, RIGHTS, Principal, check, check_command, may
from rce import messages as m
from rce.errors import Forbidden, NotFound, RceError
from rce.messages import ContainerData
from rce.roles import WITHIN, Scopes, UserRole

TIED = Principal("ann", "robot", "k", scopes=Scopes("r1", ["e1"]))


def test_every_cell_is_known() -> None:
    assert {reach for row in RIGHTS.values() for reach in row.values()} == {"-", "own", "all"}
    assert set(COLUMNS) == {"tied", *get_args(UserRole)}
    assert set(COMMANDS) == set(get_args(m.Command))
    assert set(COMMANDS.values()) <= set(RIGHTS)


@pytest.mark.parametrize("role", get_args(UserRole))
def test_a_role_within_another_may_no_more_than_that(role: UserRole) -> None:
    """But an administrator is no robot, and has no maps made."""
    for lesser in WITHIN[role]:
        for operation, row in RIGHTS.items():
            if not (role == "admin" and operation in ("robot.connect", "job.submit", "job.read")):
                order = ("-", "own", "all")
                assert order.index(row[lesser]) <= order.index(row[role]), (operation, lesser, role)
    assert role in WITHIN[role]


def test_a_tied_key_may_no_more_than_a_free_one() -> None:
    assert all(row["tied"] in ("-", row["robot"]) for row in RIGHTS.values())


@pytest.mark.parametrize("operation", RIGHTS)
@pytest.mark.parametrize("role", get_args(UserRole))
def test_anothers_looks_as_if_it_were_not_there(role: UserRole, operation: str) -> None:
    """And what is forbidden is so whoever it is that has it, or has not."""
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


def test_a_key_for_metrics_reads_those() -> None:
    principal = Principal("root", "admin", "k", scopes=Scopes(metrics=True))
    assert {operation for operation in RIGHTS if may(principal, operation, "root")} == {"metrics.read", "whoami"}


def furnished(*, hidden: bool) -> State:
    """What ann has: r1 and e1, to which the key is tied, and with `hidden` r2 and e2 too."""
    state = State()
    tags = ["1", "2"] if hidden else ["1"]
    for tag in tags:
        state.robots.put(Robot(f"ann/r{tag}", "", ""))
        state.environments.put(Environment(f"ann/e{tag}", ContainerData(), "0", ""))
        for owner, kind in ((f"r{tag}", "SubscriberConverter"), (f"e{tag}", "PublisherInterface")):
            execute(state, "ann", m.AddInterface(owner, "i", kind, "std_msgs/String"), lambda: "id")
        execute(state, "ann", m.AddNode(f"e{tag}", "n", "p", "e"), lambda: "id")
        execute(state, "ann", m.SetParameter(f"e{tag}", "p", 1), lambda: "id")
        execute(state, "ann", m.Connect(f"r{tag}/i", f"e{tag}/i"), lambda: "id")
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
    execute(state, "ann", command, lambda: "id")


@pytest.mark.parametrize("command", BEYOND_THE_TIE, ids=repr)
def test_to_a_tied_key_the_rest_does_not_exist(command: m.Command) -> None:
    said = []
    for hidden in (True, False):
        with pytest.raises(RceError) as raised:
            attempt(furnished(hidden=hidden), command)
        said.append(raised.value.info)
    assert said[0] == said[1]


def test_a_tied_key_may_do_all_to_what_it_is_tied_to() -> None:
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


def test_ties_to_a_robot_and_to_environments_stand_alone() -> None:
    state = furnished(hidden=True)
    check_command(Principal("ann", "robot", scopes=Scopes("r1")), state, "ann", m.CreateContainer("e3"))
    check_command(Principal("ann", "robot", scopes=Scopes("r1")), state, "ann", m.Connect("r1/i", "e2/i"))
    of_environments = Principal("ann", "robot", scopes=Scopes(environments=["e1"]))
    check(of_environments, "robot.connect", "ann", robot="r2")
    check_command(of_environments, state, "ann", m.Connect("r2/i", "e1/i"))
    with pytest.raises(Forbidden, match="tied to robotID r1"):
        check(TIED, "robot.connect", "ann", robot="r2")


@pytest.mark.parametrize("command", BEYOND_THE_TIE, ids=repr)
def test_a_viewer_commands_nothing(command: m.Command) -> None:
    with pytest.raises(Forbidden):
        check_command(Principal("ann", "viewer"), furnished(hidden=True), "ann", command)
