"""Connections: pairs that fit, and connections that wait for an end that is away."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from master.graph import changes, connections, reconcile, sessions
from master.graph.effects import Outcome, Plan
from master.graph.limits import Policy
from master.graph.records import Interface
from rce.control.calls.endpoints import AddRoute, Bind, RemoveRoute
from rce.control.calls.robots import SendStatus
from rce.errors import AlreadyExists, InvalidRequest, NotConnectable
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet, calls, everything, furnished, interface

PAIR = m.Connect("r1/out", "r2/in")
KEY = "ann/r1/out ann/r2/in"


def talking(by: str = "r1") -> Fleet:
    """`furnished` and ann/r2: r1/out is connected to r2/in, at the request of `by`."""
    fleet = furnished()
    fleet.robot("ann/r2")
    fleet.do("ann", interface("r1", "out", "SubscriberConverter"), robot="r1")
    declare(fleet)
    fleet.do("ann", PAIR, robot=by)
    return fleet


def declare(fleet: Fleet, kind: str = "PublisherConverter", type: str = "std_msgs/String") -> Outcome:
    """Let r2 declare its interface."""
    return fleet.do("ann", interface("r2", "in", kind, type), robot="r2")


def away(fleet: Fleet, robot: str = "r2") -> Plan:
    """Let a robot's grace period end, and let it come back in a new session."""
    plan = sessions.robot_left(fleet.state, f"ann/{robot}")
    fleet.robot(f"ann/{robot}")
    return plan


def told(plan: Plan) -> list[tuple[str, str]]:
    """Return the robots that a plan tells of a connection, and its states."""
    return [
        (robot, call.status.state)
        for call in calls(plan)
        if isinstance(call, SendStatus) and isinstance(call.status, m.ConnectionEvent)
        for robot in call.robots
    ]


# --- pairs ------------------------------------------------------------------------------------------------------------


def made(kind: str, type: str = "std_msgs/String", tag: str = "x") -> Interface:
    return Interface("", "ann/r1", tag, kind, type)


@pytest.mark.parametrize("turned", [False, True])
def test_topic_goes_from_the_subscriber_to_the_publisher(turned: bool) -> None:
    one, other = made("SubscriberConverter", tag="a"), made("PublisherInterface", "std_msgs/msg/String", "b")
    connection = connections.joining(other, one) if turned else connections.joining(one, other)
    assert (connection.sender, connection.receiver) == ("ann/r1/a", "ann/r1/b")


def test_goals_go_from_the_action_provider_to_the_action_client() -> None:
    one, other = made("ActionClientInterface", "a/Go", "a"), made("ActionProviderConverter", "a/action/Go", "b")
    connection = connections.joining(one, other)
    assert (connection.sender, connection.receiver) == ("ann/r1/b", "ann/r1/a")


@pytest.mark.parametrize(
    ("kind", "type"),
    [("SubscriberInterface", "std_msgs/String"), ("PublisherInterface", "std_msgs/Bool")],
)
def test_interfaces_that_do_not_fit_are_refused(kind: str, type: str) -> None:
    with pytest.raises(NotConnectable):
        connections.joining(made("SubscriberConverter"), made(kind, type))


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(InvalidRequest):
        connections.split_kind("Telescope")


# --- an end is away ---------------------------------------------------------------------------------------------------


def test_connection_is_back_when_the_end_is_declared_again() -> None:
    fleet = talking()
    assert ("ann/r1", "waiting") in told(away(fleet))
    assert len(fleet.state.connections) == 0
    outcome = declare(fleet)
    assert fleet.state.connections[KEY].link
    assert told(outcome.follows) == [("ann/r1", "restored")]
    assert [type(call) for call in calls(outcome.plan)] == [Bind]
    assert [type(call) for call in calls(outcome.follows)].count(AddRoute) == 2
    assert len(fleet.state.waiting) == 0


def test_connection_ends_with_the_robot_that_asked_for_it() -> None:
    """Its client declares it again if it is wanted."""
    fleet = talking(by="r2")
    assert told(away(fleet)) == []
    declare(fleet)
    assert len(fleet.state.connections) == len(fleet.state.waiting) == 0


@pytest.mark.parametrize("order", [("r1", "r2"), ("r2", "r1")])
def test_connection_ends_when_both_robots_left(order: tuple[str, str]) -> None:
    fleet = talking()
    for robot in order:
        sessions.robot_left(fleet.state, f"ann/{robot}")
    assert len(fleet.state.connections) == len(fleet.state.waiting) == 0


def test_connection_that_neither_robot_asked_for_outlives_both() -> None:
    fleet = talking(by="")
    away(fleet, "r1")
    away(fleet, "r2")
    declare(fleet)
    assert len(fleet.state.connections) == 0
    fleet.do("ann", interface("r1", "out", "SubscriberConverter"))
    assert fleet.state.connections[KEY].link


def test_connection_to_a_dead_environment_is_back_with_the_next_one_of_its_name() -> None:
    fleet = furnished()
    options = m.ContainerData(restart="no")
    commands = (
        m.CreateContainer("other", options),
        interface("other", "in", "PublisherInterface"),
        interface("r1", "out", "SubscriberConverter"),
        m.Connect("r1/out", "other/in"),
    )
    for command in commands:
        fleet.do("ann", command, robot="r1")
    plan = reconcile.environment_down(fleet.state, fleet.state.environments["ann/other"])
    assert told(plan) == [("ann/r1", "waiting")]
    for command in commands[:2]:
        outcome = fleet.do("ann", command, robot="r1")
    assert told(outcome.follows) == [("ann/r1", "restored")]


def test_interface_that_could_not_be_made_keeps_its_connections_waiting() -> None:
    fleet = talking()
    away(fleet)
    changes.undo(fleet.state, declare(fleet))
    assert [waiting.key for waiting in fleet.state.waiting] == [KEY]


def test_robot_may_declare_a_restored_connection_itself_once() -> None:
    fleet = talking()
    away(fleet)
    declare(fleet)
    assert fleet.do("ann", PAIR, robot="r2").plan == []
    with pytest.raises(AlreadyExists):
        fleet.do("ann", PAIR, robot="r2")
    away(fleet, "r1")  # r2 asked for it as well
    fleet.do("ann", interface("r1", "out", "SubscriberConverter"), robot="r1")
    assert KEY in fleet.state.connections


def test_interface_that_does_not_fit_any_more_ends_the_connection() -> None:
    fleet = talking()
    away(fleet)
    assert told(declare(fleet, type="std_msgs/Bool").follows) == [("ann/r1", "gone")]
    assert len(fleet.state.connections) == len(fleet.state.waiting) == 0


def test_connection_beyond_the_limit_is_not_restored() -> None:
    fleet = talking()
    away(fleet)
    fleet.do("ann", interface("brain", "in", "PublisherInterface"))
    fleet.do("ann", m.Connect("r1/out", "brain/in"), robot="r1")
    fleet.policy = Policy(connections=1)
    assert told(declare(fleet).follows) == [("ann/r1", "gone")]
    assert len(fleet.state.connections) == 1


# --- removed on purpose -----------------------------------------------------------------------------------------------


def remove_its_interface(fleet: Fleet) -> Plan:
    return fleet.do("ann", m.RemoveInterface("r2", "in"), robot="r2").plan


def leave_and_remove_the_other(fleet: Fleet) -> Plan:
    away(fleet)
    return fleet.do("ann", m.RemoveInterface("r1", "out"), robot="r3").plan


@pytest.mark.parametrize("remove", [remove_its_interface, leave_and_remove_the_other])
def test_robot_is_told_when_an_interface_is_removed(remove: Callable[[Fleet], Plan]) -> None:
    fleet = talking()
    plan = remove(fleet)
    assert told(plan) == [("ann/r1", "gone")]
    assert len(fleet.state.connections) == len(fleet.state.waiting) == 0


@pytest.mark.parametrize("order", [("r1/out", "r2/in"), ("r2/in", "r1/out")])
def test_connection_that_waits_can_be_disconnected(order: tuple[str, str]) -> None:
    fleet = talking()
    sessions.robot_left(fleet.state, "ann/r2")
    fleet.do("ann", m.Disconnect(*order), robot="r1")
    assert len(fleet.state.waiting) == 0


def test_waiting_connections_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "WAITING", 1)
    fleet = talking()
    fleet.do("ann", interface("r2", "more", "PublisherConverter"))
    fleet.do("ann", m.Connect("r1/out", "r2/more"), robot="r1")
    assert told(away(fleet)) == [("ann/r1", "waiting"), ("ann/r1", "gone"), ("ann/r1", "waiting")]
    assert [waiting.receiver for waiting in fleet.state.waiting] == ["ann/r2/more"]


def test_nothing_of_a_removed_user_waits() -> None:
    fleet = talking(by="")
    away(fleet)
    sessions.user_gone(fleet.state, "ann")
    assert {key for key in everything(fleet.state) if key.key.startswith("ann/")} == set()


def test_routes_of_a_connection_that_waits_are_removed() -> None:
    assert [type(call) for call in calls(away(talking()), "west")].count(RemoveRoute) == 2
