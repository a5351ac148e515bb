"""Connections: the links and routes that carry them, who dials whom, and what is closed again."""

from __future__ import annotations

import pytest
from fleet import Fleet, calls, full, furnished, interface, sends, wired

from master import wiring
from rce import messages as m
from rce.calls.endpoints import (
    AddRoute,
    CloseLink,
    OpenLink,
    RemoveRoute,
    Unbind,
)


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
