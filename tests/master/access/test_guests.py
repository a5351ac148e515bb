"""Guests: owners, clean-up, limits, and audit entries."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from master.access.users import digest
from master.graph import sessions
from master.graph.limits import Policy, usage
from master.graph.records import Robot
from rce.api.roles import Principal
from rce.control.calls.robots import Execute, Login
from rce.errors import AlreadyExists, InvalidName, LimitExceeded, RceError
from rce.protocol import messages as m
from tests.support.master.fleet import furnished, interface
from tests.support.master.served import PASSWORD, Served, serve

STRING = "std_msgs/String"


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path) as served:
        await served.master.commands.execute("ann", m.CreateContainer("brain"))
        yield served


def visit(user: str = "root", owner: str = "ann", robot: str = "@desk") -> Login:
    return Login(user, robot, digest(PASSWORD), owner=owner)


async def told(served: Served, *commands: m.Command, robot: str = "ann/@desk") -> None:
    for command in commands:
        await served.call_master("west", Execute.of(robot, command))


LISTENING = (
    m.AddInterface("@desk", "ear", "PublisherConverter", STRING),
    m.AddInterface("brain", "@desk.ear", "SubscriberInterface", STRING, "/said"),
    m.Connect("brain/@desk.ear", "@desk/ear"),
)


async def test_user_sees_guests_and_may_disconnect_them(served: Served) -> None:
    await served.call_master("west", visit())
    await told(served, *LISTENING)
    (robot,) = (await served.ask("GET", "/robots")).body["items"]
    assert (robot["robotID"], robot["guest"], robot["state"]) == ("@desk", "root", "connected")
    assert (await served.ask("GET", "/robots/%40desk")).body == robot
    assert len((await served.ask("GET", "/interfaces")).body["items"]) == 2
    assert (await served.ask("DELETE", "/robots/%40desk")).status == 204
    assert (await served.ask("GET", "/interfaces")).body["items"] == []


async def test_guest_is_audited(served: Served) -> None:
    await served.call_master("west", visit())
    await told(served, *LISTENING, m.AddInterface("brain", "@desk.mouth", "PublisherInterface", STRING, "/say"))
    for asker in ("ann", "root"):
        entries = (await served.ask("GET", "/audit?user=root", asker)).body["items"]
        found = [(each["action"], each["object"], each["result"]) for each in reversed(entries)]
        assert found == [
            ("data.read", "ann/@desk", "ok"),
            ("data.read", "ann/brain/said", "ok"),
            ("data.write", "ann/brain/say", "ok"),
        ]


async def test_guest_is_disconnected_when_its_key_is_revoked(served: Served) -> None:
    secret, key = await served.master.users.keys.add("olga", "operator")
    await served.call_master("west", Login("olga", "@desk", secret, owner="ann"))
    await told(served, *LISTENING)
    await served.master.guard.revoke_key("olga", key.id)
    assert not list(served.master.state.robots)
    assert not list(served.master.state.interfaces)


async def test_only_a_guest_may_have_another_owner(served: Served) -> None:
    for login, code in (
        (visit(robot="desk"), "invalid_request"),
        (visit("olga", robot="desk"), "invalid_request"),
        (visit("bob"), "not_found"),
        (visit("vera"), "not_found"),
        (visit(owner="nobody"), "not_found"),
        (visit(owner="ann/brain"), "invalid_name"),
        (visit(owner="ann\0"), "invalid_name"),
    ):
        with pytest.raises(RceError) as refused:
            await served.call_master("west", login)
        assert refused.value.info.code == code
    assert not list(served.master.state.robots)


async def test_guest_names_are_reserved(served: Served) -> None:
    body: dict[str, Any] = {"endpointTag": "brain", "className": STRING, "interfaceType": "SubscriberInterface"}
    for user in ("ann", "root"):
        answer = await served.ask("POST", "/interfaces?user=ann", user, body | {"interfaceTag": "@desk.ear"})
        assert (answer.status, answer.body["code"]) == (400, "invalid_name")
        node = {"nodeTag": "@desk.shell", "pkg": "p", "exe": "x"}
        assert (await served.ask("POST", "/environments/brain/nodes?user=ann", user, node)).status == 400


def test_items_of_a_guest_are_removed_with_it() -> None:
    fleet = furnished()
    fleet.policy = Policy(robots=1, connections=0)
    root = Principal("root", "admin")
    for guest in ("@desk", "@desk2"):
        sessions.robot_arrived(fleet.state, Robot(f"ann/{guest}", "west", "s", root), "", fleet.ids, fleet.policy)
    with pytest.raises(InvalidName):
        fleet.do("ann", interface("brain", "@desk.x", "SubscriberInterface"))
    for guest in ("@desk", "@desk2"):
        fleet.do("ann", interface("brain", f"{guest}.x", "SubscriberInterface"), robot=guest)
        fleet.do("ann", m.AddNode("brain", f"{guest}.shell", "p", "x"), robot=guest)
    fleet.do("ann", interface("brain", "plain", "SubscriberInterface"), robot="@desk")
    sessions.robot_left(fleet.state, "ann/@desk")
    assert {each.tag for each in fleet.state.interfaces} == {"@desk2.x", "plain"}
    assert {each.tag for each in fleet.state.nodes} == {"@desk2.shell"}


def test_only_own_guests_count_in_limits() -> None:
    fleet = furnished()
    fleet.policy = Policy(robots=1, connections=1)
    root, ann = Principal("root", "admin"), Principal("ann", "user")

    def come(guest: str, who: Principal) -> None:
        sessions.robot_arrived(fleet.state, Robot(f"ann/{guest}", "west", "s", who), "", fleet.ids, fleet.policy)

    def listen(owner: str, tag: str, guest: str = "") -> None:
        fleet.do("ann", interface(owner, "ear", "PublisherConverter"), robot=guest)
        fleet.do("ann", interface("brain", tag, "SubscriberInterface"), robot=guest)
        fleet.do("ann", m.Connect(f"brain/{tag}", f"{owner}/ear"), robot=guest)

    listen("r1", "out")
    come("@desk", root)
    listen("@desk", "@desk.out", "@desk")
    used = usage(fleet.state, "ann")
    assert (used.robots, used.connections) == (1, 1)
    with pytest.raises(LimitExceeded, match="robots: 2"):
        come("@mine", ann)
    with pytest.raises(AlreadyExists):
        come("@desk", root)


async def test_guest_who_may_only_read_listens_to_a_robot_and_sends_it_nothing(served: Served) -> None:
    await served.robot("ann", "r2")
    ears = m.AddInterface("r2", "ears", "PublisherConverter", STRING)
    await told(served, m.AddInterface("r2", "said", "SubscriberConverter", STRING), ears, robot="ann/r2")
    secret, _ = await served.master.users.keys.add("ann", "viewer")
    await served.call_master("west", Login("ann", "@desk", secret, owner="ann"))
    await told(served, LISTENING[0], m.Connect("r2/said", "@desk/ear"))
    assert len(served.master.state.connections) == 1
    for command in (m.AddInterface("@desk", "mouth", "SubscriberConverter", STRING), m.Connect("@desk/u", "r2/ears")):
        with pytest.raises(AssertionError, match="viewer may not"):
            await told(served, command)
    assert len(served.master.state.connections) == 1
