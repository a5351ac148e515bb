"""Presenter: views of records, with states, counts and measured figures."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from master.execution.readiness import Readiness
from master.graph import reconcile, sessions
from master.graph.records import Environment, Record, Robot, ref
from master.live.presenter import Presenter
from rce.api.roles import Principal
from rce.api.views import ConnectionView, GroupView, InterfaceView, NodeView, ParameterView, Rate, Usage
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet, full

ENVIRONMENT, POSE, SIDES = "ann/brain", "ann/r1/pose", "ann/r1/pose ann/brain/pose"


class Gallery:
    """A presenter of a full platform."""

    def __init__(self) -> None:
        self.fleet: Fleet = full()
        self.state = self.fleet.state
        self.readiness = Readiness()
        self.presenter = Presenter(self.state, self.readiness)

    def ready(self, record: Record) -> None:
        self.readiness.mark_ready(ref(record))

    def state_of_brain(self) -> str:
        return self.presenter.environment(self.state.environments[ENVIRONMENT]).state


@pytest.fixture
def gallery() -> Gallery:
    return Gallery()


# --- robots -----------------------------------------------------------------------------------------------------------


def test_robot_is_connected_while_its_socket_and_its_endpoint_are(gallery: Gallery) -> None:
    robot, state = gallery.state.robots["ann/r1"], gallery.state
    view = gallery.presenter.robot(robot)
    assert (view.user, view.robotID, view.endpoint, view.interfaces) == ("ann", "r1", "west", 2)
    assert view.state == "connected"
    sessions.socket_moved(state, "ann/r1", False)
    assert gallery.presenter.robot(robot).state == "away"
    sessions.socket_moved(state, "ann/r1", True)
    reconcile.left(state, "west")
    assert gallery.presenter.robot(robot).state == "away"


@pytest.mark.parametrize(("tag", "guest"), [("@console", "bob"), ("r2", "")])
def test_guest_shows_who_opened_it(gallery: Gallery, tag: str, guest: str) -> None:
    robot = Robot(f"ann/{tag}", "west", "s", Principal("bob", "operator"))
    assert gallery.presenter.robot(robot).guest == guest


# --- environments and their contents ----------------------------------------------------------------------------------


def test_environment_shows_its_options_and_counts_its_contents(gallery: Gallery) -> None:
    gallery.presenter.usage = {ENVIRONMENT: Usage(0.5, 1000)}
    view = gallery.presenter.environment(gallery.state.environments[ENVIRONMENT])
    assert (view.user, view.containerTag, view.machine, view.containerData.size) == ("ann", "brain", "m1", 1)
    assert (view.nodes, view.parameters, view.interfaces) == (1, 1, 5)
    assert view.usage == Usage(0.5, 1000)


def test_environment_shows_what_its_machine_does_not_enforce_of_what_it_asked_for(gallery: Gallery) -> None:
    gallery.fleet.join("m1", "container", capacity=9, not_enforced=["cpu", "disk", "egress", "io"])
    gallery.fleet.do("ann", m.CreateContainer("tight", m.ContainerData(cpu=1, memory=10**9, io=m.Rates(read=1))))
    view = gallery.presenter.environment(gallery.state.environments["ann/tight"])
    assert view.notEnforced == ["cpu", "egress", "io"]
    gallery.state.environments.put(replace(gallery.state.environments["ann/tight"], egress="all", machine=""))
    assert gallery.presenter.environment(gallery.state.environments["ann/tight"]).notEnforced == []


def test_environment_is_ready_between_its_sync_and_the_loss_of_its_endpoint(gallery: Gallery) -> None:
    environment = gallery.state.environments[ENVIRONMENT]
    assert gallery.state_of_brain() == "starting"
    gallery.ready(environment)
    assert gallery.state_of_brain() == "ready"
    reconcile.left(gallery.state, ENVIRONMENT)
    assert gallery.state_of_brain() == "away"


def test_environment_starts_until_its_endpoint_has_joined(gallery: Gallery) -> None:
    gallery.fleet.do("ann", m.CreateContainer("second"))
    assert gallery.presenter.environment(gallery.state.environments["ann/second"]).state == "starting"


def test_environment_without_a_machine_waits(gallery: Gallery) -> None:
    brain = gallery.state.environments[ENVIRONMENT]
    waiting = Environment(brain.name, brain.options, brain.run, "")
    assert gallery.presenter.environment(waiting).state == "waiting"


def test_node_runs_when_it_is_ready(gallery: Gallery) -> None:
    node = gallery.state.nodes["ann/brain/there"]
    assert gallery.presenter.node(node) == NodeView("ann", "brain", "there", "starting", "p", "e", "", "", "")
    gallery.ready(node)
    assert gallery.presenter.node(node).state == "running"


def test_parameter_of_a_node_names_the_node(gallery: Gallery) -> None:
    gallery.fleet.do("ann", m.SetParameter("brain", "a/b", [1, 2], "there"))
    views = [gallery.presenter.parameter(each) for each in gallery.state.parameters]
    assert views == [
        ParameterView("ann", "brain", "", "rate", 1),
        ParameterView("ann", "brain", "there", "a/b", [1, 2]),
    ]


# --- interfaces and connections ---------------------------------------------------------------------------------------


def test_interface_counts_its_connections_and_shows_its_rate(gallery: Gallery) -> None:
    interface = gallery.state.interfaces[POSE]
    gallery.presenter.rates = {POSE: Rate(2, 100)}
    assert gallery.presenter.interface(interface) == InterfaceView(
        "ann",
        "r1",
        "pose",
        "starting",
        "SubscriberConverter",
        "std_msgs/String",
        "",
        m.Qos(),
        "png",
        m.Delivery(),
        "",
        connections=1,
        rate=Rate(2, 100),
    )
    gallery.ready(interface)
    assert gallery.presenter.interface(interface).state == "ready"


def test_connection_shows_its_sides_in_the_direction_of_its_messages(gallery: Gallery) -> None:
    gallery.presenter.rates = {SIDES: Rate(2, 100)}
    view = gallery.presenter.connection(gallery.state.connections[SIDES])
    assert view == ConnectionView("ann", "r1/pose", "brain/pose", "up", "std_msgs/String", Rate(2, 100))


def test_connection_is_down_while_a_side_is_gone(gallery: Gallery) -> None:
    sessions.endpoint_gone(gallery.state, "west")
    assert gallery.presenter.connection(gallery.state.connections[SIDES]).state == "down"


# --- processes --------------------------------------------------------------------------------------------------------


def test_machine_shows_what_its_environments_use(gallery: Gallery) -> None:
    fleet = gallery.fleet
    fleet.join("m2", "container", capacity=9, gpus=3, features=["camera"])
    for tag in ("a", "b"):
        options = m.ContainerData(size=2, gpus=1, specialFeatures=["camera"])
        fleet.do("bob", m.CreateContainer(tag, options))
    gallery.presenter.usage = {"bob/a": Usage(0.5, 1000), "bob/b": Usage(0.25, 500), ENVIRONMENT: Usage(9, 9)}
    view = gallery.presenter.process(gallery.state.processes["m2"])
    assert (view.name, view.role, view.state, view.features) == ("m2", "container", "joined", ["camera"])
    assert (view.slots, view.used, view.gpus, view.gpusUsed) == (9, 4, 3, 2)
    assert (view.environments, view.robots, view.usage) == (2, 0, Usage(0.75, 1500))


def test_machine_has_the_addresses_of_all_its_processes(gallery: Gallery) -> None:
    gallery.fleet.join("here", "container", host="h", relays={"h": "10.0.0.7:4000"})
    gallery.fleet.join("there", "robot", host="h", url="ws://robots.example:9010/")
    view = gallery.presenter.process(gallery.state.processes["here"])
    assert view.addresses == ["10.0.0.7", "robots.example"]


def test_machine_is_away_during_its_grace_period_and_gone_after_it(gallery: Gallery) -> None:
    machine = gallery.state.processes["m1"]
    reconcile.left(gallery.state, "m1")
    assert gallery.presenter.process(machine).state == "away"
    gallery.state.expected.discard("m1")
    view = gallery.presenter.process(machine)
    assert (view.state, view.usage) == ("gone", None)


def test_robot_endpoint_counts_its_robots(gallery: Gallery) -> None:
    view = gallery.presenter.process(gallery.state.processes["west"])
    assert (view.role, view.robots, view.environments) == ("robot", 2, 0)


# --- groups -----------------------------------------------------------------------------------------------------------


def test_groups_of_a_user_have_the_addresses_of_their_members(gallery: Gallery) -> None:
    fleet = gallery.fleet
    for user, tag, group in (("ann", "a", "g"), ("ann", "b", "g"), ("bob", "c", "g")):
        fleet.do(user, m.CreateContainer(tag, m.ContainerData(group=group)))
    members = {"a": "10.128.0.2", "b": "10.128.0.3"}
    assert gallery.presenter.groups("ann") == [GroupView("ann", "g", "10.128.0.0/24", members)]
    assert gallery.presenter.groups("cid") == []
