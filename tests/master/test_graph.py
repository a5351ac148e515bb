"""What each command changes, which calls it leads to, and how it is refused."""

from __future__ import annotations

import pytest
from fleet import Fleet, calls, everything, furnished, interface, sends, wired

from master import graph, wiring
from master.effects import Settle
from master.records import what
from rce import messages as m
from rce.calls.endpoints import (
    AddRoute,
    Bind,
    CloseLink,
    DropParameter,
    OpenLink,
    PutParameter,
    RemoveRoute,
    StartNode,
    StopNode,
    Unbind,
)
from rce.calls.environments import StartEnvironment, StopEnvironment
from rce.errors import (
    AlreadyExists,
    InvalidName,
    InvalidRequest,
    LimitExceeded,
    NoCapacity,
    NotConnectable,
    NotFound,
    RceError,
)

REFUSED: list[tuple[m.Command, type[RceError], str]] = [
    (m.CreateContainer("brain"), AlreadyExists, "containerTag"),
    (m.CreateContainer("r1"), AlreadyExists, "containerTag"),
    (m.CreateContainer("1st"), InvalidName, "containerTag"),
    (m.CreateContainer(""), InvalidName, "containerTag"),
    (m.CreateContainer("a/b"), InvalidName, "containerTag"),
    (m.CreateContainer("big", m.ContainerData(size=4)), NoCapacity, ""),
    (m.CreateContainer("x", m.ContainerData(specialFeatures=["gpu"])), NoCapacity, ""),
    (m.CreateContainer("x", m.ContainerData(gpus=1)), NoCapacity, "containerData.gpus"),
    (m.CreateContainer("x", m.ContainerData(env={"LD_PRELOAD": "x"})), InvalidRequest, "containerData.env.LD_PRELOAD"),
    (m.CreateContainer("x", m.ContainerData(env={"A": "", "RCE_X": ""})), InvalidRequest, "containerData.env.RCE_X"),
    (m.CreateContainer("x", m.ContainerData(image="mine")), LimitExceeded, "containerData.image"),
    (m.CreateContainer("x", m.ContainerData(groupIP="192.168.1.9")), InvalidRequest, "containerData.groupIP"),
    (m.CreateContainer("x", m.ContainerData(group="g", groupIP="10.0.0.1")), InvalidRequest, "containerData.groupIP"),
    (m.CreateContainer("x", m.ContainerData(group="g", groupIp="1.2.3")), InvalidRequest, "containerData.groupIP"),
    (
        m.CreateContainer("x", m.ContainerData(group="g", groupIP="192.168.1.1")),
        InvalidRequest,
        "containerData.groupIP",
    ),
    (
        m.CreateContainer("x", m.ContainerData(group="g", groupIP="192.168.1.0")),
        InvalidRequest,
        "containerData.groupIP",
    ),
    (
        m.CreateContainer("x", m.ContainerData(group="g", groupIP="192.168.1.255")),
        InvalidRequest,
        "containerData.groupIP",
    ),
    (m.DestroyContainer("nobody"), NotFound, "containerTag"),
    (m.DestroyContainer("r1"), NotFound, "containerTag"),
    (m.AddNode("nobody", "n", "p", "e"), NotFound, "containerTag"),
    (m.AddNode("r1", "n", "p", "e"), NotFound, "containerTag"),
    (m.AddNode("brain", "n-1", "p", "e"), InvalidName, "nodeTag"),
    (m.AddNode("brain", "there", "p", "e"), AlreadyExists, "nodeTag"),
    (m.RemoveNode("brain", "nobody"), NotFound, "nodeTag"),
    (m.RemoveNode("nobody", "there"), NotFound, "containerTag"),
    (m.SetParameter("nobody", "rate", 1), NotFound, "containerTag"),
    (m.SetParameter("brain", "rate", 1, "a:b"), InvalidName, "nodeTag"),
    (m.DeleteParameter("brain", "nothing"), NotFound, "name"),
    (m.DeleteParameter("brain", "rate", "there"), NotFound, "name"),
    (m.DeleteParameter("nobody", "rate"), NotFound, "containerTag"),
    (interface("r1", "new", "Publisher"), InvalidRequest, "interfaceType"),
    (interface("r1", "new", "PublisherXConverter"), InvalidRequest, "interfaceType"),
    (interface("r1", "new", "PublisherInterface"), NotFound, "endpointTag"),
    (interface("brain", "new", "PublisherConverter"), NotFound, "endpointTag"),
    (interface("nobody", "new", "PublisherForwarder"), NotFound, "endpointTag"),
    (interface("r1", "new tag", "PublisherConverter"), InvalidName, "interfaceTag"),
    (interface("r1", "new", "PublisherConverter", "String"), InvalidRequest, "className"),
    (interface("r1", "pose", "PublisherConverter"), AlreadyExists, "interfaceTag"),
    (m.RemoveInterface("r1", "nothing"), NotFound, "interfaceTag"),
    (m.RemoveInterface("nobody", "pose"), NotFound, "interfaceTag"),
    (m.Connect("r1", "brain/pose"), InvalidRequest, "tagA"),
    (m.Connect("r1/pose", "brain/pose/x"), InvalidName, "tagB (interfaceTag)"),
    (m.Connect("r1/nothing", "brain/pose"), NotFound, "tagA"),
    (m.Connect("r1/pose", "brain/nothing"), NotFound, "tagB"),
    (m.Connect("r1/pose", "r1/pose"), NotConnectable, ""),
    (m.Connect("r1/pose", "brain/pose"), AlreadyExists, ""),
    (m.Connect("brain/pose", "r1/pose"), AlreadyExists, ""),
    (m.Connect("r1/pose", "brain/scans"), NotConnectable, ""),  # two senders
    (m.Connect("r1/pose", "brain/number"), NotConnectable, ""),  # other type
    (m.Connect("r1/pose", "brain/answer"), NotConnectable, ""),  # topic and service
    (m.Connect("r1/ask", "brain/answer2"), NotConnectable, ""),  # a second peer of a provider
    (m.Disconnect("r1/pose", "brain/number"), NotFound, ""),
    (m.Disconnect("r1/nothing", "brain/pose"), NotFound, "tagA"),
]


def full() -> Fleet:
    fleet = wired()
    for command in (
        m.AddNode("brain", "there", "p", "e"),
        m.SetParameter("brain", "rate", 1),
        interface("brain", "scans", "SubscriberInterface"),
        interface("brain", "number", "PublisherInterface", "std_msgs/Int32"),
        interface("brain", "answer", "ServiceClientInterface", "std_srvs/Empty"),
        interface("brain", "answer2", "ServiceClientInterface", "std_srvs/Empty"),
        interface("r1", "ask", "ServiceProviderConverter", "std_srvs/Empty"),
        m.Connect("r1/ask", "brain/answer"),
    ):
        fleet.do("ann", command)
    return fleet


@pytest.mark.parametrize(("command", "error", "field"), REFUSED, ids=lambda value: getattr(value, "__name__", None))
def test_a_refused_command_changes_nothing_and_names_the_field(
    command: m.Command, error: type[RceError], field: str
) -> None:
    fleet = full()
    before = everything(fleet.state)
    with pytest.raises(RceError) as raised:
        fleet.do("ann", command)
    assert type(raised.value) is error
    assert raised.value.field == field
    assert everything(fleet.state) == before


@pytest.mark.parametrize(
    "command",
    [
        m.DestroyContainer("brain"),
        m.AddNode("brain", "n", "p", "e"),
        m.RemoveNode("brain", "there"),
        m.SetParameter("brain", "rate", 2),
        m.DeleteParameter("brain", "rate"),
        interface("brain", "new", "PublisherInterface"),
        m.RemoveInterface("brain", "pose"),
        m.Connect("r1/pose", "brain/pose"),
        m.Disconnect("r1/pose", "brain/pose"),
        m.RemoveInterface("../ann/brain", "pose"),
    ],
    ids=lambda command: type(command).__name__,
)
def test_another_users_things_do_not_exist(command: m.Command) -> None:
    fleet = full()
    before = everything(fleet.state)
    with pytest.raises(NotFound):
        fleet.do("bob", command)
    assert everything(fleet.state) == before


def test_a_tag_is_free_for_each_user() -> None:
    fleet = furnished()
    fleet.do("bob", m.CreateContainer("brain"))
    assert "ann/brain" in fleet.state.environments
    assert "bob/brain" in fleet.state.environments


# --- what is done -----------------------------------------------------------------------------------------------------


def test_create_starts_on_the_machine_and_waits_for_the_environment() -> None:
    fleet = furnished()
    outcome = fleet.do("ann", m.CreateContainer("second", m.ContainerData(size=2)))
    environment = fleet.state.environments["ann/second"]
    (send,) = sends(outcome.plan)
    assert (send.to, send.key) == ("m1", "ann/second")
    assert isinstance(send.call, StartEnvironment)
    assert (send.call.environment.run, send.call.environment.token) == (environment.run, "")
    assert outcome.awaits == [what(environment)]


def test_destroy_takes_all_that_is_in_it() -> None:
    fleet = full()
    plan = fleet.do("ann", m.DestroyContainer("brain")).plan
    assert [record.key for record in fleet.state.interfaces] == ["ann/r1/pose", "ann/r1/ask"]
    for table in (fleet.state.environments, fleet.state.nodes, fleet.state.parameters, fleet.state.connections):
        assert len(table) == 0
    assert len(fleet.state.links) == 0
    assert calls(plan, "m1") == [StopEnvironment("ann/brain")]
    assert {type(call) for call in calls(plan, "west")} == {RemoveRoute, CloseLink}


def test_a_namesake_of_a_destroyed_environment_is_another_one() -> None:
    """The process of the first is still connected for a while: it gets nothing of what the second shall have."""
    fleet = full()
    fleet.do("ann", m.DestroyContainer("brain"))
    fleet.do("ann", m.CreateContainer("brain"))
    bound = fleet.do("ann", interface("brain", "pose", "PublisherInterface"))
    connected = fleet.do("ann", m.Connect("r1/pose", "brain/pose"))
    assert bound.plan == connected.plan == []
    assert connected.awaits == ["Connection ann/r1/pose ann/brain/pose"]


def test_node_and_parameter_are_made_at_the_environment() -> None:
    fleet = furnished()
    added = fleet.do("ann", m.AddNode("brain", "n", "p", "e", "-x", "name", "space"))
    put = fleet.do("ann", m.SetParameter("brain", "rate", 5, "n"))
    node, parameter = fleet.state.nodes["ann/brain/n"], fleet.state.parameters["ann/brain/n:rate"]
    assert calls(added.plan + put.plan, "ann/brain") == [StartNode(node.spec), PutParameter(parameter.spec)]
    assert [steps[-1] for steps in added.plan + put.plan] == [Settle(what(node)), Settle(what(parameter))]
    removed = fleet.do("ann", m.RemoveNode("brain", "n")).plan
    dropped = fleet.do("ann", m.DeleteParameter("brain", "rate", "n")).plan
    assert calls(removed + dropped, "ann/brain") == [StopNode("n"), DropParameter("n:rate")]
    assert not [step for steps in removed + dropped for step in steps if isinstance(step, Settle)]


def test_a_parameter_may_be_set_again() -> None:
    fleet = furnished()
    fleet.do("ann", m.SetParameter("brain", "rate", 5))
    fleet.do("ann", m.SetParameter("brain", "rate", 6))
    assert fleet.state.parameters["ann/brain/:rate"].spec.value == 6


@pytest.mark.parametrize("alias", list(m.ALIASES))
def test_old_names_of_interface_types_are_accepted(alias: str) -> None:
    fleet = furnished()
    owner = "brain" if alias.endswith("Interface") else "r1"
    fleet.do("ann", interface(owner, "s", alias, "std_srvs/Empty"))
    assert fleet.state.interfaces[f"ann/{owner}/s"].spec.kind == m.ALIASES[alias]


def test_connecting_opens_a_link_and_routes_the_receiver_first() -> None:
    fleet = wired()
    fleet.do("ann", interface("r1", "two", "PublisherConverter"))
    fleet.do("ann", interface("brain", "two", "SubscriberInterface"))
    (steps,) = fleet.do("ann", m.Connect("r1/two", "brain/two")).plan
    (link,) = fleet.state.links
    robot, brain = (fleet.state.interfaces[f"ann/{owner}/two"].spec.id for owner in ("r1", "brain"))
    assert (link.listener, link.dialler) == ("west", "ann/brain")
    assert [(type(send.call), send.to) for send in sends([steps])] == [
        (OpenLink, "west"),
        (OpenLink, "ann/brain"),
        (AddRoute, "west"),
        (AddRoute, "ann/brain"),
    ]
    received = calls([steps], "west")[1]
    assert isinstance(received, AddRoute)
    assert (received.route.interface, received.route.peer) == (robot, brain)


def test_only_ends_on_one_host_learn_the_socket_file() -> None:
    fleet = wired()
    opened = next(call for call in calls(fleet.join("ann/brain", "environment", "2", host="h2"), "ann/brain"))
    near = next(
        call.link
        for call in calls(fleet.join("ann/brain", "environment", "3", host="h1"), "ann/brain")
        if isinstance(call, OpenLink)
    )
    assert near.dial == ["unix:/w", "tcp:w:1"]
    assert opened is not None
    far = next(
        call.link
        for call in calls(fleet.join("ann/brain", "environment", "4", host="h2"), "ann/brain")
        if isinstance(call, OpenLink)
    )
    assert far.dial == ["tcp:w:1"]
    assert near.key != far.key


def dialled(fleet: Fleet, one: str, other: str) -> tuple[str, list[str]]:
    """Who dials for the only link of these two, and where."""
    (link,) = [each for each in fleet.state.links if {each.listener, each.dialler} == {one, other}]
    return link.dialler, wiring.link_spec(fleet.state, link, link.dialler).dial


def test_from_afar_an_environment_is_dialled_through_the_relay_of_its_machine() -> None:
    fleet = wired()
    fleet.join("m1", "container", capacity=4, addresses=["relay:m1:2"], environments=runs(fleet))
    fleet.join("ann/brain", "environment", "2", host="h2", addresses=["unix:/b"])
    assert dialled(fleet, "west", "ann/brain") == ("west", ["relay:m1:2/ann/brain"])
    fleet.join("m2", "container", capacity=9, addresses=["relay:m2:2"])
    fleet.do("ann", m.CreateContainer("eye", m.ContainerData(size=4)))
    fleet.join("ann/eye", "environment", "2", host="h1", addresses=["unix:/e"])
    for tag, end in (("brain", "Publisher"), ("eye", "Subscriber")):
        fleet.do("ann", interface(tag, "view", f"{end}Interface"))
    fleet.do("ann", m.Connect("eye/view", "brain/view"))
    assert dialled(fleet, "ann/brain", "ann/eye") == ("ann/eye", ["relay:m1:2/ann/brain"])
    fleet.do("ann", interface("eye", "pose", "PublisherInterface"))
    fleet.do("ann", m.Connect("r1/pose", "eye/pose"))
    assert dialled(fleet, "west", "ann/eye") == ("west", ["unix:/e"])  # on one host


def runs(fleet: Fleet) -> dict[str, str]:
    return {each.name: each.run for each in fleet.state.environments}


def test_connections_share_a_link_but_keep_all_has_its_own() -> None:
    fleet = wired()
    for tag, history in (("two", "keep_last"), ("all", "keep_all")):
        fleet.do("ann", interface("r1", tag, "SubscriberConverter"))
        fleet.do("ann", interface("brain", tag, "PublisherInterface", qos=m.Qos(history=history)))
        fleet.do("ann", m.Connect(f"r1/{tag}", f"brain/{tag}"))
    links = {record.sender.rpartition("/")[2]: record.link for record in fleet.state.connections}
    assert links["pose"] == links["two"] != links["all"]


def test_two_robots_at_one_endpoint_have_a_link_without_key() -> None:
    fleet = furnished()
    fleet.robot("ann/r2")
    fleet.do("ann", interface("r1", "out", "SubscriberForwarder"))
    fleet.do("ann", interface("r2", "in", "PublisherConverter", "std_msgs/msg/String"))
    plan = fleet.do("ann", m.Connect("r2/in", "r1/out")).plan
    (link,) = fleet.state.links
    assert (link.listener, link.dialler, link.key_hex) == ("west", "west", "")
    assert [type(call) for call in calls(plan)] == [OpenLink, AddRoute, AddRoute]


@pytest.mark.parametrize("order", [("r1/pose", "brain/pose"), ("brain/pose", "r1/pose")])
def test_disconnecting_parts_both_and_closes_the_unused_link(order: tuple[str, str]) -> None:
    fleet = wired()
    plan = fleet.do("ann", m.Disconnect(*order)).plan
    assert len(fleet.state.connections) == len(fleet.state.links) == 0
    assert sorted(type(call).__name__ for call in calls(plan)) == ["CloseLink"] * 2 + ["RemoveRoute"] * 2


def test_a_link_in_use_stays() -> None:
    fleet = full()
    fleet.do("ann", m.Disconnect("r1/pose", "brain/pose"))
    assert len(fleet.state.links) == 1


def test_removing_an_interface_parts_it_before_it_is_unbound() -> None:
    fleet = wired()
    plan = fleet.do("ann", m.RemoveInterface("r1", "pose")).plan
    assert [type(call) for call in calls(plan, "west")] == [RemoveRoute, CloseLink, Unbind]


# --- again ------------------------------------------------------------------------------------------------------------

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
def test_what_is_there_is_waited_for_when_asked_again(command: m.Command) -> None:
    fleet = full()
    before = everything(fleet.state)
    outcome = fleet.do("ann", command, again=True)
    assert everything(fleet.state) == before
    (key,) = outcome.awaits
    assert key in before


@pytest.mark.parametrize("command", UNDOING, ids=lambda command: type(command).__name__)
def test_what_is_gone_is_no_error_when_asked_again(command: m.Command) -> None:
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
def test_something_else_by_that_name_is_an_error_again_too(command: m.Command) -> None:
    with pytest.raises(AlreadyExists):
        full().do("ann", command, again=True)


# --- undo -------------------------------------------------------------------------------------------------------------


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
def test_undo_leaves_the_state_before_the_command(command: m.Command) -> None:
    fleet = full()
    fleet.do("ann", interface("brain", "second", "PublisherInterface"))
    before = everything(fleet.state)
    outcome = fleet.do("ann", command)
    assert everything(fleet.state) != before
    assert sends(graph.undo(fleet.state, outcome))
    assert everything(fleet.state) == before


def test_a_refused_parameter_gives_way_to_the_one_before() -> None:
    fleet = full()
    fleet.do("ann", m.SetParameter("brain", "speed", 1))
    before = everything(fleet.state)
    outcome = fleet.do("ann", m.SetParameter("brain", "speed", "fast"))
    assert sends(graph.undo(fleet.state, outcome))
    assert everything(fleet.state) == before


def test_an_interface_is_bound_where_its_robot_is() -> None:
    fleet = furnished()
    plan = fleet.do("ann", interface("r1", "x", "PublisherConverter")).plan
    assert [(send.to, type(send.call)) for send in sends(plan)] == [("west", Bind)]


def test_what_an_environment_sends_is_taken_at_its_bandwidth_by_others() -> None:
    fleet = Fleet()
    fleet.join("west", "robot", host="h1", addresses=["tcp:w:1"])
    fleet.join("m1", "container", capacity=4)
    fleet.robot("ann/r1")
    fleet.do("ann", m.CreateContainer("brain", m.ContainerData(bandwidth=5000)))
    fleet.join("ann/brain", "environment", host="h2")
    fleet.do("ann", interface("r1", "pose", "SubscriberConverter"))
    fleet.do("ann", interface("brain", "pose", "PublisherInterface"))
    fleet.do("ann", m.Connect("r1/pose", "brain/pose"))
    (link,) = fleet.state.links
    at_robot, at_environment = (wiring.link_spec(fleet.state, link, end) for end in ("west", "ann/brain"))
    assert (at_robot.rate, at_robot.sender) == (5000, "ann/brain")
    assert (at_environment.rate, at_environment.sender) == (0, "")
    assert at_robot.key == at_environment.key
    assert len(at_robot.dial) + len(at_environment.dial) == 1


def test_gpus_are_found_where_they_are_free() -> None:
    """A machine has them for itself; the one with more free slots has none."""
    fleet = Fleet()
    fleet.join("plain", "container", capacity=9)
    fleet.join("graphic", "container", capacity=3, gpus=2)
    fleet.do("ann", m.CreateContainer("one", m.ContainerData(gpus=1)))
    fleet.do("bob", m.CreateContainer("two", m.ContainerData(gpus=1)))
    assert {each.machine for each in fleet.state.environments} == {"graphic"}
    with pytest.raises(NoCapacity) as raised:
        fleet.do("bob", m.CreateContainer("three", m.ContainerData(gpus=1)))
    assert raised.value.info.fields == {"asked": 1, "free": 0}
    fleet.do("ann", m.DestroyContainer("one"))
    fleet.do("bob", m.CreateContainer("three", m.ContainerData(gpus=1)))
