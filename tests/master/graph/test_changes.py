"""Changes of the graph: starts, removals with what hangs on them, and undoing commands."""

from __future__ import annotations

import pytest

from master.graph import changes, reconcile
from master.graph.changes import undo
from master.graph.effects import MarkReady
from master.graph.limits import Policy
from master.graph.records import ref
from master.graph.translation import node_spec
from rce.control.calls.endpoints import CloseLink, RemoveRoute, StartNode, Unbind
from rce.control.calls.environments import StartEnvironment, StopEnvironment
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet, calls, everything, full, furnished, interface, sends, wired

# --- starts -----------------------------------------------------------------------------------------------------------


def test_environment_starts_with_its_group_packages_and_egress() -> None:
    fleet = Fleet()
    fleet.join("m1", "container", capacity=4)
    fleet.policy = Policy(egress="internet")
    fleet.do("ann", m.CreateContainer("brain", m.ContainerData(group="g")))
    (call,) = calls(changes.start(fleet.state, fleet.state.environments["ann/brain"]))
    assert isinstance(call, StartEnvironment)
    spec = call.environment
    assert spec.group is not None
    assert (spec.group.name, spec.group.members, spec.egress) == ("ann/g", {"brain": spec.group.address}, "internet")
    assert spec.token == ""  # issued when the call leaves


def test_environment_that_waits_for_a_machine_is_not_started() -> None:
    fleet = furnished()
    waiting = fleet.state.environments["ann/brain"]
    reconcile.left(fleet.state, "m1")
    reconcile.environment_down(fleet.state, waiting)
    fleet.state.forget("m1")
    assert reconcile.restart(fleet.state, waiting, fleet.ids) == []
    assert changes.start(fleet.state, fleet.state.environments["ann/brain"]) == []


# --- removals ---------------------------------------------------------------------------------------------------------


def test_removed_environment_leaves_nothing_behind() -> None:
    fleet = full()
    changes.remove_environment(fleet.state, fleet.state.environments["ann/brain"])
    assert not [key for key in everything(fleet.state) if "ann/brain" in key.key]
    assert "ann/brain" not in fleet.state.joined


def test_machine_that_is_away_is_not_told_to_stop_an_environment() -> None:
    """It learns it from KeepEnvironments when it joins again."""
    fleet = furnished()
    reconcile.left(fleet.state, "m1")
    plan = changes.remove_environment(fleet.state, fleet.state.environments["ann/brain"])
    assert StopEnvironment("ann/brain") not in calls(plan)
    assert "ann/brain" not in fleet.state.environments


def test_removed_interface_is_unbound_after_its_routes_are_removed() -> None:
    fleet = wired()
    plan = changes.remove_interface(fleet.state, fleet.state.interfaces["ann/brain/pose"])
    assert [type(call) for call in calls(plan, "ann/brain")] == [RemoveRoute, CloseLink, Unbind]
    assert [type(call) for call in calls(plan, "west")] == [RemoveRoute, CloseLink]
    assert len(fleet.state.connections) == 0


def test_interface_of_an_endpoint_that_is_away_is_removed_without_calls() -> None:
    fleet = furnished()
    fleet.do("ann", interface("r1", "pose", "SubscriberConverter"))
    reconcile.left(fleet.state, "west")
    assert changes.remove_interface(fleet.state, fleet.state.interfaces["ann/r1/pose"]) == []
    assert len(fleet.state.interfaces) == 0


def test_connection_of_two_interfaces_of_one_owner_is_removed_once() -> None:
    fleet = furnished()
    fleet.do("ann", interface("r1", "out", "SubscriberForwarder"))
    fleet.do("ann", interface("r1", "in", "PublisherForwarder"))
    fleet.do("ann", m.Connect("r1/out", "r1/in"))
    plan = changes.remove_interfaces(fleet.state, "ann/r1", away=True)
    assert [type(call) for call in calls(plan)].count(RemoveRoute) == 2
    assert len(fleet.state.interfaces) == len(fleet.state.connections) == 0


# --- calls at the environment of a record -----------------------------------------------------------------------------


def test_node_is_ready_when_its_environment_has_started_it() -> None:
    fleet = full()
    node = fleet.state.nodes["ann/brain/there"]
    (steps,) = changes.call_host(fleet.state, node, StartNode(node_spec(node)))
    assert [send.to for send in sends([steps])] == ["ann/brain"]
    assert steps[-1] == MarkReady(ref(node))


def test_environment_that_is_away_is_not_called() -> None:
    """It gets the node by its next Sync."""
    fleet = full()
    node = fleet.state.nodes["ann/brain/there"]
    reconcile.left(fleet.state, "ann/brain")
    assert changes.call_host(fleet.state, node, StartNode(node_spec(node))) == []


# --- undoing ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        m.CreateContainer("other"),
        m.AddNode("brain", "n", "p", "e"),
        m.SetParameter("brain", "other", 1),
        interface("r1", "other", "PublisherConverter"),
        m.Connect("r1/pose", "brain/second"),
    ],
    ids=lambda command: type(command).__name__,
)
def test_undo_restores_the_state_before_the_command(command: m.Command) -> None:
    fleet = full()
    fleet.do("ann", interface("brain", "second", "PublisherInterface"))
    before = everything(fleet.state)
    outcome = fleet.do("ann", command)
    assert everything(fleet.state) != before
    assert sends(undo(fleet.state, outcome))
    assert everything(fleet.state) == before


def test_refused_parameter_is_replaced_by_its_former_value() -> None:
    fleet = full()
    fleet.do("ann", m.SetParameter("brain", "speed", 1))
    before = everything(fleet.state)
    outcome = fleet.do("ann", m.SetParameter("brain", "speed", "fast"))
    assert sends(undo(fleet.state, outcome))
    assert everything(fleet.state) == before


@pytest.mark.parametrize("former", [[], [m.SetParameter("brain", "speed", 1)]], ids=["new", "changed"])
def test_value_of_a_later_command_is_not_undone(former: list[m.Command]) -> None:
    fleet = full()
    for command in former:
        fleet.do("ann", command)
    refused = fleet.do("ann", m.SetParameter("brain", "speed", "fast"))
    fleet.do("ann", m.SetParameter("brain", "speed", 2))
    assert undo(fleet.state, refused) == []
    assert fleet.state.parameters["ann/brain/:speed"].value == 2


def test_undoing_what_was_removed_meanwhile_does_nothing() -> None:
    fleet = full()
    outcomes = [
        fleet.do("ann", command)
        for command in (
            m.AddNode("brain", "n", "p", "e"),
            m.SetParameter("brain", "rate", 9),
            interface("brain", "new", "PublisherInterface"),
            m.Connect("r1/pose", "brain/new"),
        )
    ]
    fleet.do("ann", m.DestroyContainer("brain"))
    before = everything(fleet.state)
    assert [undo(fleet.state, outcome) for outcome in outcomes] == [[]] * 4
    assert everything(fleet.state) == before
