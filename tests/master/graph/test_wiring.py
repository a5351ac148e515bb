"""Wiring: links and routes of connections, addresses to dial, and closing."""

from __future__ import annotations

from typing import Any

import pytest

from master.graph import reconcile, wiring
from master.graph.effects import MarkReady
from master.graph.records import Process, ref
from rce.control.calls.endpoints import AddRoute, CloseLink, OpenLink, RemoveRoute, Unbind
from rce.control.calls.environments import SetRelays
from rce.errors import Unavailable
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet, calls, full, furnished, interface, sends, wired


def test_connecting_opens_a_link_and_routes_the_receiver_first() -> None:
    fleet = wired()
    fleet.do("ann", interface("r1", "two", "PublisherConverter"))
    fleet.do("ann", interface("brain", "two", "SubscriberInterface"))
    (steps,) = fleet.do("ann", m.Connect("r1/two", "brain/two")).plan
    (link,) = fleet.state.links
    robot, brain = (fleet.state.interfaces[f"ann/{owner}/two"].id for owner in ("r1", "brain"))
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


def test_open_link_is_not_opened_again() -> None:
    fleet = wired()
    fleet.do("ann", interface("r1", "two", "PublisherConverter"))
    fleet.do("ann", interface("brain", "two", "SubscriberInterface"))
    (steps,) = fleet.do("ann", m.Connect("r1/two", "brain/two")).plan
    (link,) = fleet.state.links
    opening = [send for send in sends([steps]) if isinstance(send.call, OpenLink)]
    assert {send.unless for send in opening} == {ref(link)}
    assert steps[len(opening)] == MarkReady(ref(link)), "before the routes, and only if both ends have answered"


def test_socket_file_is_told_to_ends_on_the_same_host_only() -> None:
    fleet, links = wired(), []
    for incarnation, host in (("2", "h1"), ("3", "h2")):
        fleet.join("m1", "container", host=host, environments=runs(fleet))
        plan = fleet.join("ann/brain", "environment", incarnation)
        links += [call.link for call in calls(plan, "ann/brain") if isinstance(call, OpenLink)]
    assert [each.dial for each in links] == [["unix:/w", "tcp:w:1"], ["tcp:w:1"]]
    assert links[0].key != links[1].key


HOSTILE = ["tcp:169.254.169.254:80", "tcp:metadata.example:80", "unix:/var/run/docker.sock", "relay:10.0.0.1:22/ann/x"]


@pytest.mark.parametrize("several_hosts", [False, True])
def test_environment_does_not_choose_what_others_dial(several_hosts: bool) -> None:
    fleet = wired()
    relays = {"h2": "m1:2"}
    machine: dict[str, Any] = {"relays": relays} if several_hosts else {"relays": relays, "host": "h2"}
    fleet.join("m1", "container", capacity=4, sockets="/e/{run}.sock", environments=runs(fleet), **machine)
    said = {"url": "http://169.254.169.254/", "capacity": 9, "features": ["camera"], "sockets": "/var/run/docker.sock"}
    plan = fleet.join(
        "ann/brain", "environment", "2", host="h2", addresses=HOSTILE, relays={"h2": "169.254.169.254:80"}, **said
    )
    assert fleet.state.processes["ann/brain"] == Process("ann/brain", "environment", "2", "h2")
    dialled = [call.link.dial for send in sends(plan) if isinstance(call := send.call, OpenLink)]
    assert sorted(dialled) == [[], ["relay:m1:2/ann/brain"]]


def test_environment_is_on_a_host_of_its_task_set() -> None:
    """Else others on that host would dial it by a socket there."""
    fleet = wired()
    fleet.join("m1", "container", capacity=4, relays={"h2": "m1:2", "h3": "m3:2"}, environments=runs(fleet))
    with pytest.raises(Unavailable, match="m1 has not told yet how the host of ann/brain is reached"):
        fleet.join("ann/brain", "environment", "2", host="h1")
    fleet.join("m1", "container", capacity=4, host="h2", environments=runs(fleet))
    fleet.join("ann/brain", "environment", "2", host="h1")
    assert fleet.state.processes["ann/brain"].host == "h2"


def test_relay_that_moved_is_dialled_at_its_new_address() -> None:
    fleet = wired()
    fleet.join("m1", "container", capacity=4, relays={"h2": "m1:2"}, environments=runs(fleet))
    fleet.join("ann/brain", "environment", "2", host="h2")
    assert dialled(fleet, "west", "ann/brain") == ("west", ["relay:m1:2/ann/brain"])
    plan = reconcile.relays_changed(fleet.state, "m1", {"h2": "m1:3"})
    assert calls(plan, "m1") == [SetRelays(["m1:3"])]
    assert dialled(fleet, "west", "ann/brain") == ("west", ["relay:m1:3/ann/brain"])
    assert reconcile.relays_changed(fleet.state, "m1", {"h2": "m1:3"}) == []


def dialled(fleet: Fleet, one: str, other: str) -> tuple[str, list[str]]:
    """Return the dialling process and the addresses of the only link of these two."""
    (link,) = [each for each in fleet.state.links if {each.listener, each.dialler} == {one, other}]
    return link.dialler, wiring.link_spec(fleet.state, link, link.dialler).dial


def test_environment_on_another_host_is_dialled_through_its_relay() -> None:
    fleet = wired()
    paths = "/e/{name}/{user}/{run}"
    fleet.join("m1", "container", host="h2", sockets=paths, relays={"h2": "m1:2"}, environments=runs(fleet))
    fleet.join("ann/brain", "environment", "2")
    assert dialled(fleet, "west", "ann/brain") == ("west", ["relay:m1:2/ann/brain"])
    fleet.join("m2", "container", capacity=9, host="h1", sockets=paths, relays={"h1": "m2:2"})
    fleet.do("ann", m.CreateContainer("eye", m.ContainerData(size=4)))
    fleet.join("ann/eye", "environment", "2")
    for tag, end in (("brain", "Publisher"), ("eye", "Subscriber")):
        fleet.do("ann", interface(tag, "view", f"{end}Interface"))
    fleet.do("ann", m.Connect("eye/view", "brain/view"))
    assert dialled(fleet, "ann/brain", "ann/eye") == ("ann/eye", ["relay:m1:2/ann/brain"])
    fleet.do("ann", interface("eye", "pose", "PublisherInterface"))
    fleet.do("ann", m.Connect("r1/pose", "eye/pose"))
    run = runs(fleet)["ann/eye"]
    assert dialled(fleet, "west", "ann/eye") == ("west", [f"unix:/e/ann/eye/ann/{run}"])  # on one host


def runs(fleet: Fleet) -> dict[str, str]:
    return {each.name: each.run for each in fleet.state.environments}


def test_connections_share_a_link_except_for_keep_all() -> None:
    fleet = wired()
    for tag, qos in (("two", m.Qos(history="keep_last")), ("all", m.Qos(history="keep_all"))):
        fleet.do("ann", interface("r1", tag, "SubscriberConverter"))
        fleet.do("ann", interface("brain", tag, "PublisherInterface", qos=qos))
        fleet.do("ann", m.Connect(f"r1/{tag}", f"brain/{tag}"))
    links = {record.sender.rpartition("/")[2]: record.link for record in fleet.state.connections}
    assert links["pose"] == links["two"] != links["all"]


def test_link_within_one_endpoint_has_no_key() -> None:
    fleet = furnished()
    fleet.robot("ann/r2")
    fleet.do("ann", interface("r1", "out", "SubscriberForwarder"))
    fleet.do("ann", interface("r2", "in", "PublisherConverter", "std_msgs/msg/String"))
    plan = fleet.do("ann", m.Connect("r2/in", "r1/out")).plan
    (link,) = fleet.state.links
    assert (link.listener, link.dialler, link.key_hex) == ("west", "west", "")
    assert [type(call) for call in calls(plan)] == [OpenLink, AddRoute, AddRoute]


@pytest.mark.parametrize("order", [("r1/pose", "brain/pose"), ("brain/pose", "r1/pose")])
def test_disconnecting_removes_both_routes_and_closes_the_unused_link(order: tuple[str, str]) -> None:
    fleet = wired()
    plan = fleet.do("ann", m.Disconnect(*order)).plan
    assert len(fleet.state.connections) == len(fleet.state.links) == 0
    assert sorted(type(call).__name__ for call in calls(plan)) == ["CloseLink"] * 2 + ["RemoveRoute"] * 2


def test_link_in_use_stays_open() -> None:
    fleet = full()
    fleet.do("ann", m.Disconnect("r1/pose", "brain/pose"))
    assert len(fleet.state.links) == 1


def test_routes_are_removed_before_an_interface_is_unbound() -> None:
    fleet = wired()
    plan = fleet.do("ann", m.RemoveInterface("r1", "pose")).plan
    assert [type(call) for call in calls(plan, "west")] == [RemoveRoute, CloseLink, Unbind]


def test_peers_receive_from_an_environment_at_its_bandwidth() -> None:
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
    assert (at_environment.rate, at_environment.sender) == (0, "west")
    assert at_robot.key == at_environment.key
    assert len(at_robot.dial) + len(at_environment.dial) == 1
