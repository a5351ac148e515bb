"""Commands: their changes of the records, the calls that follow, and repetition."""

from __future__ import annotations

import pytest

from master.graph.effects import MarkReady
from master.graph.records import Ref, ref
from master.graph.translation import node_spec, parameter_spec
from rce.control.calls.endpoints import (
    Bind,
    CloseLink,
    DropParameter,
    NodeSpec,
    PutParameter,
    RemoveRoute,
    StartNode,
    StopNode,
)
from rce.control.calls.environments import StartEnvironment, StopEnvironment
from rce.errors import AlreadyExists, InvalidRequest
from rce.protocol import messages as m
from tests.support.master.fleet import calls, everything, full, furnished, interface, sends


def test_create_starts_the_environment_and_awaits_it() -> None:
    fleet = furnished()
    outcome = fleet.do("ann", m.CreateContainer("second", m.ContainerData(size=2)))
    environment = fleet.state.environments["ann/second"]
    (send,) = sends(outcome.plan)
    assert (send.to, send.about) == ("m1", Ref("environment", "ann/second"))
    assert isinstance(send.call, StartEnvironment)
    assert (send.call.environment.run, send.call.environment.token) == (environment.run, "")
    assert outcome.awaits == [ref(environment)]


def test_destroy_removes_everything_in_the_environment() -> None:
    fleet = full()
    plan = fleet.do("ann", m.DestroyContainer("brain")).plan
    assert [record.key for record in fleet.state.interfaces] == ["ann/r1/pose", "ann/r1/ask"]
    for table in (fleet.state.environments, fleet.state.nodes, fleet.state.parameters, fleet.state.connections):
        assert len(table) == 0
    assert len(fleet.state.links) == 0
    assert calls(plan, "m1") == [StopEnvironment("ann/brain")]
    assert {type(call) for call in calls(plan, "west")} == {RemoveRoute, CloseLink}


def test_new_environment_of_an_old_name_is_another_one() -> None:
    """The process of the first stays connected for a while; it must get no calls for the second."""
    fleet = full()
    fleet.do("ann", m.DestroyContainer("brain"))
    fleet.do("ann", m.CreateContainer("brain"))
    bound = fleet.do("ann", interface("brain", "pose", "PublisherInterface"))
    connected = fleet.do("ann", m.Connect("r1/pose", "brain/pose"))
    assert bound.plan == connected.plan == []
    assert connected.awaits == [Ref("connection", "ann/r1/pose ann/brain/pose")]


def test_node_and_parameter_are_sent_to_the_environment() -> None:
    fleet = furnished()
    added = fleet.do("ann", m.AddNode("brain", "n", "p", "e", "-x", "name", "space"))
    put = fleet.do("ann", m.SetParameter("brain", "rate", 5, "n"))
    node, parameter = fleet.state.nodes["ann/brain/n"], fleet.state.parameters["ann/brain/n:rate"]
    assert calls(added.plan + put.plan, "ann/brain") == [
        StartNode(node_spec(node)),
        PutParameter(parameter_spec(parameter)),
    ]
    assert [steps[-1] for steps in added.plan + put.plan] == [MarkReady(ref(node)), MarkReady(ref(parameter))]
    removed = fleet.do("ann", m.RemoveNode("brain", "n")).plan
    dropped = fleet.do("ann", m.DeleteParameter("brain", "rate", "n")).plan
    assert calls(removed + dropped, "ann/brain") == [StopNode("n"), DropParameter("n:rate")]
    assert not [step for steps in removed + dropped for step in steps if isinstance(step, MarkReady)]


def test_node_that_exists_is_kept_or_replaced_if_the_command_says_so() -> None:
    fleet = furnished()
    fleet.do("ann", m.AddNode("brain", "n", "p", "e"))
    assert calls(fleet.do("ann", m.AddNode("brain", "n", "p", "e", existOk=True)).plan, "ann/brain") == []
    changed = fleet.do("ann", m.AddNode("brain", "n", "p", "e", "--fast", existOk=True)).plan
    assert calls(changed, "ann/brain") == [StartNode(NodeSpec("n", "p", "e", "--fast"))]
    assert fleet.state.nodes["ann/brain/n"].arguments == "--fast"


def test_parameter_can_be_set_again() -> None:
    fleet = furnished()
    fleet.do("ann", m.SetParameter("brain", "rate", 5))
    fleet.do("ann", m.SetParameter("brain", "rate", 6))
    assert fleet.state.parameters["ann/brain/:rate"].value == 6


@pytest.mark.parametrize("alias", list(m.ALIASES))
def test_old_names_of_interface_types_are_accepted(alias: str) -> None:
    fleet = furnished()
    owner = "brain" if alias.endswith("Interface") else "r1"
    fleet.do("ann", interface(owner, "s", alias, "std_srvs/Empty"))
    assert fleet.state.interfaces[f"ann/{owner}/s"].kind == m.ALIASES[alias]


MAKING: list[m.Command] = [
    m.CreateContainer("brain"),
    m.AddNode("brain", "there", "p", "e"),
    m.SetParameter("brain", "rate", 1),
    interface("brain", "pose", "PublisherInterface"),
    m.Connect("brain/pose", "r1/pose"),
]
UNDOING: list[m.Command] = [
    m.DestroyContainer("gone"),
    m.RemoveNode("brain", "gone"),
    m.DeleteParameter("brain", "gone"),
    m.RemoveInterface("brain", "gone"),
    m.Disconnect("r1/pose", "brain/scans"),
]


@pytest.mark.parametrize("command", MAKING, ids=lambda command: type(command).__name__)
def test_repeated_command_awaits_what_exists(command: m.Command) -> None:
    fleet = full()
    before = everything(fleet.state)
    outcome = fleet.do("ann", command, again=True)
    assert everything(fleet.state) == before
    (key,) = (*outcome.awaits, *outcome.needs)
    assert key in before


@pytest.mark.parametrize("command", UNDOING, ids=lambda command: type(command).__name__)
def test_repeated_removal_is_no_error(command: m.Command) -> None:
    fleet = full()
    before = everything(fleet.state)
    outcome = fleet.do("ann", command, again=True)
    assert (outcome.plan, outcome.awaits) == ([], [])
    assert everything(fleet.state) == before


@pytest.mark.parametrize(
    "command",
    [
        m.CreateContainer("r1"),
        m.AddNode("brain", "there", "p", "other"),
        interface("brain", "pose", "SubscriberInterface"),
    ],
    ids=lambda command: type(command).__name__,
)
def test_repeated_command_with_other_content_is_an_error(command: m.Command) -> None:
    with pytest.raises(AlreadyExists):
        full().do("ann", command, again=True)


def test_interface_is_bound_at_the_endpoint_of_its_robot() -> None:
    fleet = furnished()
    plan = fleet.do("ann", interface("r1", "x", "PublisherConverter")).plan
    assert [(send.to, type(send.call)) for send in sends(plan)] == [("west", Bind)]


@pytest.mark.parametrize(("endpoint", "kind"), [("brain", "PublisherInterface"), ("r1", "ServiceClientConverter")])
def test_delivery_is_refused_where_nothing_crosses_the_line_as_a_topic(endpoint: str, kind: m.InterfaceType) -> None:
    fleet = furnished()
    command = m.AddInterface(endpoint, "in", kind, "std_msgs/String", delivery=m.Delivery("high"))
    with pytest.raises(InvalidRequest, match="has no delivery") as raised:
        fleet.do("ann", command)
    assert raised.value.info.field == "delivery"


@pytest.mark.parametrize(
    ("option", "delivery"),
    [("fields", m.Delivery(fields=("data",))), ("decimate", m.Delivery(decimate=m.Decimation(2)))],
)
def test_messages_from_a_robot_are_not_made_smaller(option: str, delivery: m.Delivery) -> None:
    command = m.AddInterface("r1", "out", "SubscriberConverter", "std_msgs/String", delivery=delivery)
    with pytest.raises(InvalidRequest, match=rf"a SubscriberConverter has no delivery\.{option}") as raised:
        furnished().do("ann", command)
    assert raised.value.info.field == f"delivery.{option}"


def test_environment_with_the_name_of_a_robot_is_refused_with_the_kind_of_its_owner() -> None:
    fleet = furnished()
    for name, kind in (("r1", "robot"), ("brain", "environment")):
        with pytest.raises(AlreadyExists, match=f"in use by an? {kind} of yours") as raised:
            fleet.do("ann", m.CreateContainer(name))
        assert raised.value.info.fields == {"kind": kind}
