"""Robot sessions, endpoints and links: login, resume, loss and end."""

from __future__ import annotations

import asyncio

import pytest

from master.access.users import digest
from rce.control.calls.endpoints import AddRoute, Bind, LinkLost, OpenLink, RemoveRoute, Report, Sync, Unbind
from rce.control.calls.robots import DropRobot, Login, SendStatus, SessionExpired, SocketStatus
from rce.errors import AlreadyExists, ErrorInfo, InvalidRequest, NotFound, Unauthorized, Unavailable
from rce.protocol import messages as m
from tests.support.master.peers import Furnished, Platform, execute, login, told


async def test_wrong_credentials_and_administrators_are_refused(platform: Platform) -> None:
    west = await platform.endpoint()
    await platform.master.users.add("boss", "secret", "admin")
    with pytest.raises(Unauthorized):
        await west.call(Login("ann", "r1", digest("wrong")))
    with pytest.raises(Unauthorized):
        await west.call(Login("nobody", "r1", digest("secret")))
    with pytest.raises(InvalidRequest):
        await west.call(Login("boss", "r1", digest("secret")))
    assert len(platform.master.state.robots) == 0


async def test_robot_cannot_log_in_twice(furnished: Furnished) -> None:
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/r1")
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/r1", resume="guess")
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/brain")
    await login(furnished.west, "bob/r1")


async def test_restarted_robot_takes_the_place_of_the_one_without_a_socket(furnished: Furnished) -> None:
    await furnished.west.call(SocketStatus("ann/r1", False))
    east = await furnished.platform.endpoint("east")
    assert not (await login(east, "ann/r1")).resumed
    assert (await furnished.west.next(DropRobot)).robot == "ann/r1"
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/r1", furnished.session.token)


async def test_robot_resumes_at_another_endpoint(furnished: Furnished) -> None:
    east = await furnished.platform.endpoint("east")
    answer = await login(east, "ann/r1", furnished.session.token)
    assert answer.resumed
    assert [type(call).__name__ for call in east.arrived if not isinstance(call, SendStatus)] == [
        *("Sync", "Bind", "OpenLink", "AddRoute")
    ]
    assert (await furnished.west.next(DropRobot)).robot == "ann/r1"
    with pytest.raises(NotFound):
        await execute(furnished.west, "ann/r1", m.DestroyContainer("brain"))


async def test_login_succeeds_although_a_binding_fails(furnished: Furnished) -> None:
    """A robot that was refused would have a session without a token to resume it."""
    east = await furnished.platform.endpoint("east")
    east.refuse[Bind] = NotFound("unknown type")
    answer = await login(east, "ann/r1", furnished.session.token)
    assert answer.resumed
    assert (await told(east, ErrorInfo)).message == "unknown type"


async def test_login_that_a_full_disk_refuses_leaves_the_name_free(platform: Platform) -> None:
    west = await platform.endpoint()
    await platform.fill_disk()
    with pytest.raises(Unavailable, match="disk full"):
        await west.call(Login("ann", "r1", digest("secret"), address=f"tcp4:{'x' * 8000}:1"))
    assert len(platform.master.state.robots) == 0
    await platform.fill_disk(False)
    assert not (await west.call(Login("ann", "r1", digest("secret")))).resumed


async def test_command_that_a_full_disk_refuses_is_taken_back(furnished: Furnished) -> None:
    platform, wanted = furnished.platform, m.SetParameter("brain", "text", "x" * 100_000)
    await platform.fill_disk()
    with pytest.raises(Unavailable, match="disk full"):
        await execute(furnished.west, "ann/r1", wanted)
    assert not [*platform.master.state.parameters]
    await platform.fill_disk(False)
    await execute(furnished.west, "ann/r1", wanted)


async def test_robot_whose_answer_to_a_resumption_was_lost_resumes_again(furnished: Furnished) -> None:
    token = furnished.session.token
    assert (await login(furnished.west, "ann/r1", token)).resumed  # the robot does not get this
    again = await login(furnished.west, "ann/r1", token)
    assert again.resumed
    await login(furnished.west, "ann/r1", again.token)
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/r1", token)


async def test_robots_of_a_lost_endpoint_are_removed(platform: Platform) -> None:
    platform.master.process_tracker.grace = 0.0
    west = await platform.endpoint()
    await login(west, "ann/r1")
    await west.leave()
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "west" not in platform.master.state.processes


async def test_reconnected_endpoint_keeps_its_robots(furnished: Furnished) -> None:
    platform, west = furnished.platform, furnished.west
    await west.leave()
    (timer,) = platform.master.process_tracker._away.values()
    back = await platform.endpoint(token=west.credential, robots=["ann/r1"])
    sync = await back.next(Sync)
    assert sync.robots == ["ann/r1"]
    assert [(route.link, link.name) for route, link in zip(sync.routes, sync.links, strict=True)] == [
        (furnished.link, furnished.link)
    ]
    await execute(back, "ann/r1", m.Disconnect("r1/pose", "brain/pose"))
    await asyncio.wait([timer])
    assert timer.cancelled()


async def test_restarted_endpoint_has_lost_its_robots(furnished: Furnished) -> None:
    platform, west = furnished.platform, furnished.west
    await west.leave()
    platform.master.process_tracker.grace = 0.0
    back = await platform.endpoint(token=west.credential, incarnation="2")
    sync = await back.next(Sync)
    assert (sync.robots, sync.interfaces, sync.links) == ([], [], [])
    await furnished.brain.next(RemoveRoute)
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "ann/brain" in platform.master.state.environments


async def test_leaving_removes_the_robots_interfaces_and_those_that_it_added_for_them(furnished: Furnished) -> None:
    await furnished.west.call(SessionExpired("ann/r1"))
    await furnished.brain.next(RemoveRoute)
    await furnished.brain.next(Unbind)
    assert [each.key for each in furnished.platform.master.state.interfaces] == []


async def test_lost_link_is_reopened_at_both_ends(furnished: Furnished) -> None:
    await furnished.brain.next(AddRoute)
    await furnished.brain.call(LinkLost(furnished.link, "reset"))
    opened = await furnished.brain.next(OpenLink)
    assert opened.link.name != furnished.link
    assert (await furnished.brain.next(AddRoute)).route.link == opened.link.name
    await furnished.west.call(LinkLost(furnished.link, "reset"))  # the report of the other end is ignored
    assert [link.name for link in furnished.platform.master.state.links] == [opened.link.name]


async def test_only_ends_may_report_a_lost_link(furnished: Furnished) -> None:
    platform = furnished.platform
    robot = await login(furnished.west, "bob/r1")
    assert not robot.resumed
    made = execute(furnished.west, "bob/r1", m.CreateContainer("evil"))
    evil = await platform.environment(furnished.m1)
    await made
    await evil.call(LinkLost(furnished.link, "lie"))
    assert [link.name for link in platform.master.state.links] == [furnished.link]
    furnished.west.arrived.clear()
    furnished.west._taken = 0
    await evil.call(Report("ann/r1", "pose", ErrorInfo("died", "lie")))
    tell = await furnished.west.next(SendStatus)
    while tell.error is None:
        tell = await furnished.west.next(SendStatus)
    assert tell.robots == ["bob/r1"]


@pytest.mark.parametrize("command", [m.DestroyContainer("brain"), m.Disconnect("r1/pose", "brain/pose")])
async def test_things_of_another_user_are_not_found(furnished: Furnished, command: m.Command) -> None:
    await login(furnished.west, "bob/other")
    with pytest.raises(NotFound):
        await execute(furnished.west, "bob/other", command)


async def test_connection_completes_when_a_side_returns(furnished: Furnished) -> None:
    """Calls reach the side that is present; the other gets the route by its Sync."""
    platform, west, brain = furnished.platform, furnished.west, furnished.brain
    await execute(west, "ann/r1", m.AddInterface("r1", "two", "SubscriberConverter", "a/B"))
    await execute(west, "ann/r1", m.AddInterface("brain", "two", "PublisherInterface", "a/B"))
    await brain.leave()
    connected = asyncio.ensure_future(execute(west, "ann/r1", m.Connect("r1/two", "brain/two")))
    await platform.until(lambda: "ann/r1/two ann/brain/two" in platform.master.state.connections)
    back = await platform.process("environment", "ann/brain", token=brain.credential)
    assert len((await back.next(Sync)).routes) == 1
    await connected
