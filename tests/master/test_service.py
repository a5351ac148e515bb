"""The Master as a whole: which processes may join and what they may call, questions to them, and its restart."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import msgspec
import pytest
from msgspec import Raw
from msgspec.structs import replace

import rce
from master.access.audit import AuditFilter
from master.access.users import Users
from master.access.users import digest as sha256
from master.graph.records import Environment, EnvironmentOptions, Package, Process, Role, Version
from master.graph.state import State
from master.service import Master
from master.storage.depot import FETCH_PATH, Depot
from master.storage.store import Store
from rce.api.roles import Scopes
from rce.control.calls.endpoints import CloseLink, OpenLink, Report, Sync
from rce.control.calls.environments import (
    DownloadTicket,
    FetchPackage,
    KeepEnvironments,
    ReportRelays,
    SetRelays,
    StartEnvironment,
)
from rce.control.calls.joining import Hello
from rce.control.calls.robots import DescribeType, Login, ReadGraphFor, ReadRobotsFor, SendStatus
from rce.control.calls.watching import RosNode
from rce.control.pages import Question
from rce.errors import AlreadyExists, ErrorInfo, InvalidRequest, NotFound, Unauthorized, Unavailable, UnknownType
from rce.protocol import messages as m
from tests.support.master.peers import Furnished, Platform, execute, login, told

DIGEST, MISSING, UNUSED = "a" * 64, "b" * 64, "d" * 64

# --- joining ----------------------------------------------------------------------------------------------------------


async def test_process_of_another_version_is_refused(platform: Platform) -> None:
    await platform.master.join_tokens.allow("west", "robot", "token")
    with pytest.raises(InvalidRequest, match=f"robot west is version 0.0, the Master {rce.__version__}"):
        await platform.master.join(Hello("robot", "west", "token", "0.0"), "memory")


async def test_process_gets_a_credential_with_which_it_joins_again(platform: Platform) -> None:
    first = await platform.endpoint()
    assert first.credential
    again = await platform.endpoint(token=first.credential)
    await platform.until(lambda: first.control.lost.done())  # one connection of a process at a time
    await again.next(Sync)


async def test_process_of_an_environment_is_known_by_the_run_of_the_environment(furnished: Furnished) -> None:
    state = furnished.platform.master.state
    assert state.processes["ann/brain"].incarnation == state.environments["ann/brain"].run


async def test_removed_environment_cannot_join(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.DestroyContainer("brain"))
    with pytest.raises(Unauthorized):
        await furnished.platform.process("environment", "ann/brain", token=furnished.brain.credential)


async def test_hello_of_an_environment_decides_nothing_that_others_dial(platform: Platform) -> None:
    """Programs in an environment can join in place of their endpoint."""
    west, machine = await platform.endpoint(), {"host": "h", "sockets": "/e/{run}", "relays": {"h": "m1:2"}}
    m1 = await platform.process("container", "m1", capacity=4, **machine)
    await login(west, "ann/r1")
    made = execute(west, "ann/r1", m.CreateContainer("brain"))
    spec = (await m1.next(StartEnvironment)).environment
    hostile = ["tcp:169.254.169.254:80", "tcp:metadata.example:80", "unix:/var/run/docker.sock"]
    more: dict[str, object] = {"addresses": hostile, "url": "http://169.254.169.254/", "relays": {"h": "10.0.0.1:22"}}
    brain = await platform.process("environment", spec.name, spec.run, token=spec.token, capacity=9, **more)
    await brain.next(Sync)
    await made
    for command in (
        m.AddInterface("r1", "pose", "SubscriberConverter", "std_msgs/String"),
        m.AddInterface("brain", "pose", "PublisherInterface", "std_msgs/String"),
        m.Connect("r1/pose", "brain/pose"),
    ):
        await execute(west, "ann/r1", command)
    assert (await west.next(OpenLink)).link.dial == ["relay:m1:2/ann/brain"]
    assert platform.master.state.processes["ann/brain"] == Process("ann/brain", "environment", spec.run, "h")


async def test_environment_waits_until_its_host_is_known(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4, relays={"n1": "n1:2"})
    await login(west, "ann/r1")
    made = execute(west, "ann/r1", m.CreateContainer("brain"))
    spec = (await m1.next(StartEnvironment)).environment
    with pytest.raises(Unavailable, match="m1 has not told yet"):
        await platform.process("environment", spec.name, spec.run, token=spec.token, host="n2", credential="c" * 64)
    await m1.call(ReportRelays({"n1": "n1:2", "n2": "n2:2"}))
    assert (await m1.next(SetRelays)).relays == ["n1:2", "n2:2"]
    brain = await platform.process("environment", spec.name, spec.run, token=spec.token, host="n2", credential="c" * 64)
    await brain.next(Sync)
    await made
    assert platform.master.state.processes["ann/brain"].host == "n2"


CALLS_OF_ROLES: dict[str, set[str]] = {
    "robot": {"Login", "SessionExpired", "SocketStatus", "Execute", "DescribeType", "ReadGraphFor", "ReadRobotsFor"},
    "container": {"EnvironmentDied", "LimitReached", "FetchPackage", "ReportRelays"},
    "environment": {"NodeDied", "Report"},
    "service": {"Authenticate", "RecordAction", "CreateGrant", "IssueKey", "RevokeGrant"},
}


@pytest.mark.parametrize("role", get_args(Role))
async def test_process_may_make_the_calls_of_its_role_only(platform: Platform, role: Role) -> None:
    handlers = platform.master._handlers(Process("name", role, "1"))
    answered = set()
    for call in set().union(*CALLS_OF_ROLES.values()):
        answer = await handlers.answer(Question(call, "", 0, Raw(b"no call")))
        assert not answer.good
        if "does not answer" not in msgspec.msgpack.decode(answer.value, type=ErrorInfo).message:
            answered.add(call)
    assert answered == CALLS_OF_ROLES[role]


# --- calls of processes -----------------------------------------------------------------------------------------------


async def test_type_is_looked_up_in_the_users_environments(furnished: Furnished) -> None:
    answer = await furnished.west.call(DescribeType("ann", "my_msgs/msg/A", "msg"))
    assert answer.texts == {"my_msgs/msg/A": "of ann/brain"}


async def test_type_that_only_another_users_environment_has_is_unknown(furnished: Furnished) -> None:
    with pytest.raises(UnknownType, match="neither here nor in an environment of bob"):
        await furnished.west.call(DescribeType("bob", "my_msgs/msg/A", "msg"))


async def test_graph_is_read_for_who_may_see_the_environment(furnished: Furnished) -> None:
    with pytest.raises(NotFound, match="no session"):
        await furnished.west.call(ReadGraphFor("ann/r9", "brain"))
    with pytest.raises(NotFound, match="no environment 'other'"):
        await furnished.west.call(ReadGraphFor("ann/r1", "other"))
    robot = furnished.platform.master.state.robots.get("ann/r1")
    assert robot is not None
    tied = replace(robot.by, role="robot", scopes=Scopes(environments=["elsewhere"]))
    furnished.platform.master.state.robots.put(replace(robot, principal=tied))
    with pytest.raises(NotFound, match="no environment 'brain'"):
        await furnished.west.call(ReadGraphFor("ann/r1", "brain"))
    furnished.platform.master.state.robots.put(robot)
    assert (await furnished.west.call(ReadGraphFor("ann/r1", "brain"))).nodes == [RosNode("/ann/brain")]


async def test_robots_are_listed_for_who_may_see_them(furnished: Furnished) -> None:
    with pytest.raises(NotFound, match="no session"):
        await furnished.west.call(ReadRobotsFor("ann/r9"))
    found = (await furnished.west.call(ReadRobotsFor("ann/r1"))).interfaces
    assert {each.robot for each in found} == {"r1"}
    robot = furnished.platform.master.state.robots.get("ann/r1")
    assert robot is not None
    tied = replace(robot.by, role="robot", scopes=Scopes(robot="r9"))
    furnished.platform.master.state.robots.put(replace(robot, principal=tied))
    assert (await furnished.west.call(ReadRobotsFor("ann/r1"))).interfaces == [], "its key is tied to another robot"


async def test_error_of_an_environment_reaches_the_robots_of_its_user(furnished: Furnished) -> None:
    await login(furnished.west, "bob/r1")
    await furnished.brain.call(Report("ann/brain", "pose", ErrorInfo("invalid_request", "no such type")))
    assert (await told(furnished.west, ErrorInfo)).message == "no such type"
    sent = [(call.robots, call.error) for call in furnished.west.arrived if isinstance(call, SendStatus)]
    assert sent[1:] == [(["ann/r1"], ErrorInfo("invalid_request", "no such type"))]  # after that it is ready


async def test_status_for_all_robots_of_a_user_is_one_call_to_each_endpoint(furnished: Furnished) -> None:
    await login(furnished.west, "ann/r2")
    east = await furnished.platform.endpoint("east")
    await login(east, "ann/r3")
    await furnished.brain.call(Report("ann/brain", "pose", ErrorInfo("invalid_request", "no such type")))
    assert (await east.next(SendStatus)).robots == ["ann/r3"]
    await told(furnished.west, ErrorInfo)
    sent = [call.robots for call in furnished.west.arrived if isinstance(call, SendStatus)]
    assert [sorted(robots) for robots in sent[1:]] == [["ann/r1", "ann/r2"]]


async def test_statuses_go_to_robots_that_asked_for_events(furnished: Furnished) -> None:
    await furnished.west.call(Login("ann", "plain", sha256("secret")))
    await furnished.brain.call(Report("ann/brain", "pose", ErrorInfo("invalid_request", "no such type")))
    await told(furnished.west, ErrorInfo)
    sent = [call.robots for call in furnished.west.arrived if isinstance(call, SendStatus)]
    assert sent[1:] == [["ann/r1"]]


async def test_drops_of_an_environment_reach_the_robots_of_its_user(furnished: Furnished) -> None:
    await login(furnished.west, "bob/r1")
    await furnished.brain.call(Report("ann/brain", "pose", drops=3))
    assert await told(furnished.west, m.DropEvent) == m.DropEvent("brain/pose", 3, "in environment brain")
    sent = [call.robots for call in furnished.west.arrived if isinstance(call, SendStatus)]
    assert sent[1:] == [["ann/r1"]]


# --- questions to processes -------------------------------------------------------------------------------------------


async def test_environment_that_is_away_is_unavailable(furnished: Furnished) -> None:
    environment = furnished.platform.master.state.environments["ann/brain"]
    await furnished.brain.leave()
    with pytest.raises(Unavailable, match="environment ann/brain is away"):
        await furnished.platform.master.ask(environment, DescribeType("ann", "x", "msg"))


async def test_metrics_of_a_process_that_is_away_are_unavailable(platform: Platform) -> None:
    with pytest.raises(Unavailable):
        await platform.master.metrics_of("west")


async def test_what_the_platform_lacks_is_named(platform: Platform) -> None:
    assert len(await platform.master.missing()) == 2
    await platform.endpoint()
    assert await platform.master.missing() == ["no Container task set has joined: environments cannot be started"]


# --- packages ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def depot(tmp_path: Path) -> Depot:
    depot = Depot(tmp_path / "packages")
    for digest in (DIGEST, UNUSED):
        (tmp_path / "packages" / digest).write_bytes(b"archive")
    return depot


async def fetch(master: Master, machine: str, digest: str) -> DownloadTicket:
    return await master._fetch_package(Process(machine, "container", "1"), FetchPackage(digest))


async def test_task_set_gets_tickets_for_packages_of_its_environments_only(store: Store, depot: Depot) -> None:
    master = Master(store, 10, depot=depot)
    master.entry = ("https", 9000)
    options = EnvironmentOptions()
    master.state.environments.put(Environment("ann/brain", options, "r", "m1", packages=[DIGEST, MISSING]))
    ticket = await fetch(master, "m1", DIGEST)
    assert (ticket.scheme, ticket.port, ticket.path, ticket.size) == ("https", 9000, FETCH_PATH, len(b"archive"))
    found = depot.fetch(ticket.token)
    assert found is not None
    assert found.read_bytes() == b"archive"
    for machine, digest in (("m2", DIGEST), ("m1", "c" * 64), ("m1", MISSING)):
        with pytest.raises(NotFound):
            await fetch(master, machine, digest)


async def test_packages_of_removed_users_are_dropped_at_the_start(store: Store, depot: Depot, users: Users) -> None:
    before = State()
    before.packages.put(Package("ann/tool", [Version(DIGEST, 7, ["p"], 0.0)], ["gone", "*"]))
    before.packages.put(Package("gone/tool", [Version(MISSING, 7, ["p"], 0.0)], ["ann"]))
    await store.save(before)
    master = Master(store, 10, depot=depot)
    await master.start()
    assert {each.name: each.shared for each in master.state.packages} == {"ann/tool": ["*"]}
    assert {path.name for path in depot.incoming.parent.iterdir()} == {DIGEST, "incoming"}
    await master.stop()


# --- restart ----------------------------------------------------------------------------------------------------------


async def restart(furnished: Furnished) -> Platform:
    platform = furnished.platform
    await platform.stop()
    await platform.start()
    return platform


async def test_state_survives_a_restart_of_the_master(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    platform = await restart(furnished)
    west = await platform.endpoint(token=furnished.west.credential, robots=["ann/r1"])
    m1 = await platform.process(
        "container", "m1", capacity=4, token=furnished.m1.credential, environments={"ann/brain": run}
    )
    brain = await platform.process("environment", "ann/brain", run, token=furnished.brain.credential)
    assert (await m1.next(KeepEnvironments)).runs == [run]
    for peer in (west, brain):
        sync = await peer.next(Sync)
        assert ([link.name for link in sync.links], len(sync.routes)) == ([furnished.link], 1)
    for command in (
        m.CreateContainer("brain"),
        m.AddInterface("r1", "pose", "SubscriberConverter", "std_msgs/String"),
        m.Connect("r1/pose", "brain/pose"),
    ):
        await execute(west, "ann/r1", command, again=True)
        with pytest.raises(AlreadyExists):
            await execute(west, "ann/r1", command)
    for peer in (west, brain, m1):
        assert not [call for call in peer.arrived if isinstance(call, OpenLink | StartEnvironment | CloseLink)]
    assert (await login(west, "ann/r1", furnished.session.token)).resumed


async def test_audit_log_is_complete_when_the_master_stops(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.DestroyContainer("brain"))
    platform = await restart(furnished)
    (last, *_) = await platform.master.audit.find(AuditFilter(), None, 1)
    assert (last.action, last.object) == ("environment.remove", "ann/brain")


async def test_new_process_gets_new_links_after_a_restart_of_the_master(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    platform = await restart(furnished)
    m1 = await platform.process("container", "m1", capacity=4, token=furnished.m1.credential)
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.run != run
    west = await platform.endpoint(token=furnished.west.credential, robots=["ann/r1"])
    assert (await west.next(Sync)).routes == []
    await platform.process("environment", spec.name, token=spec.token)
    assert (await west.next(OpenLink)).link.name != furnished.link


async def test_interfaces_of_a_robot_that_resumes_after_both_restarted_are_ready(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    platform = await restart(furnished)
    await platform.process("environment", "ann/brain", run, token=furnished.brain.credential)
    west = await platform.endpoint(token=furnished.west.credential, incarnation="2")  # without its robots
    assert (await login(west, "ann/r1", furnished.session.token)).resumed
    pose = platform.master.state.interfaces["ann/r1/pose"]
    assert platform.master.presenter.interface(pose).state == "ready"


async def test_processes_that_do_not_return_after_a_restart_are_removed(furnished: Furnished) -> None:
    furnished.platform.grace = 0.0
    platform = await restart(furnished)
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "ann/brain" in platform.master.state.environments


async def test_key_revoked_while_the_master_is_down_closes_its_sockets(platform: Platform) -> None:
    west = await platform.endpoint()
    secret, key = await platform.master.users.keys.add("ann")
    await west.call(Login("ann", "by_key", secret))
    await login(west, "ann/by_password")
    await platform.stop()
    await platform.start()
    await platform.master.users.keys.revoke("ann", key.id)
    await platform.master.guard.check_all()
    assert [robot.name for robot in platform.master.state.robots] == ["ann/by_password"]
