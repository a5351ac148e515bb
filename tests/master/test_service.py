"""The Master with real control connections: task set, endpoints and their calls over loopback."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

import pytest
from twisted.internet.base import ReactorBase

import rce
from master import attendance
from master.audit import Wanted
from master.service import Master
from master.store import Store
from master.users import digest
from rce import messages as m
from rce.calls.call import Call, Nothing, Settled
from rce.calls.endpoints import (
    AddRoute,
    Bind,
    CloseLink,
    DropParameter,
    LinkLost,
    NodeDied,
    OpenLink,
    PutParameter,
    RemoveRoute,
    Report,
    StartNode,
    StopNode,
    Sync,
    Unbind,
)
from rce.calls.environments import (
    EnvironmentDied,
    KeepEnvironments,
    KnowRelays,
    LimitReached,
    StartEnvironment,
    StopEnvironment,
)
from rce.calls.joining import Hello
from rce.calls.robots import Definitions, Describe, DropRobot, Execute, Leave, LoggedIn, Login, Tell
from rce.calls.services import Borrow, Delegate, EndGrant, NoteDone, Person, Vouch
from rce.control import Control, Handlers, connect, listen
from rce.errors import AlreadyExists, ErrorInfo, Forbidden, InvalidRequest, NotFound, StartFailed, Unauthorized

T = TypeVar("T", bound=Call[Any])
PATIENCE = 20.0  # seconds until a test that hangs fails
LONG = 1000.0  # a grace time that does not end within a test


class Peer:
    """A process that has joined the Master: keeps what it is called with and answers as `refuse` says."""

    def __init__(self, platform: Platform, hello: Hello) -> None:
        self.platform = platform
        self.hello = hello
        self.arrived: list[Call[Any]] = []
        self.refuse: dict[type[Call[Any]], Exception] = {}
        self.failed: dict[str, ErrorInfo] = {}  # what Sync is answered with
        self._changed = asyncio.Event()
        self._taken = 0

    async def join(self) -> Peer:
        handlers = Handlers()
        for kind in (
            *(Bind, Unbind, OpenLink, CloseLink, AddRoute, RemoveRoute, StartNode, StopNode),
            *(PutParameter, DropParameter, Tell, DropRobot),
            *(StartEnvironment, StopEnvironment, KeepEnvironments, KnowRelays),
        ):
            handlers.on(kind, self._take)
        handlers.on(Sync, self._sync)
        handlers.on(Describe, self._describe)
        self.control, welcome = await connect(self.platform.reactor, self.platform.address, self.hello, handlers)
        self.platform.controls.append(self.control)
        self.credential = welcome.credential
        return self

    async def _take(self, call: Call[Any]) -> Nothing:
        self.arrived.append(call)
        self._changed.set()
        if type(call) in self.refuse:
            raise self.refuse[type(call)]
        return Nothing()

    async def _sync(self, call: Sync) -> Settled:
        await self._take(call)
        return Settled(self.failed)

    async def _describe(self, call: Describe) -> Definitions:
        return Definitions({call.type: f"of {self.hello.name}"})

    async def next(self, kind: type[T]) -> T:
        """The next call of this kind, of those that were not looked at yet; those before it are passed over."""

        async def search() -> T:
            while True:
                while self._taken < len(self.arrived):
                    call = self.arrived[self._taken]
                    self._taken += 1
                    if isinstance(call, kind):
                        return call
                self._changed.clear()
                await self._changed.wait()

        return await asyncio.wait_for(search(), PATIENCE)

    async def call(self, call: Call[Any]) -> Any:
        return await asyncio.wait_for(self.control.call(call), PATIENCE)

    async def leave(self) -> None:
        self.control.close()
        await self.platform.until(lambda: self.hello.name not in self.platform.master.state.joined)


class Platform:
    """A Master and those who joined it."""

    def __init__(self, reactor: ReactorBase, database: str, grace: float) -> None:
        self.reactor = reactor
        self.database = database
        self.grace = grace
        self.controls: list[Control] = []

    async def start(self) -> None:
        self.store = Store(self.database)
        await self.store.open()
        self.master = Master(self.store, self.grace)
        await self.master.start()
        self.port = await listen(self.reactor, "tcp:0:interface=127.0.0.1", self.master)
        self.address = f"tcp:127.0.0.1:{self.port.getHost().port}"  # type: ignore[misc,attr-defined]

    async def stop(self) -> None:
        await asyncio.sleep(0)
        self.port.stopListening()  # type: ignore[misc]
        for control in [*self.controls, *self.master._carrier.controls.values()]:
            control.close()
        await asyncio.wait_for(asyncio.gather(*(control.lost for control in self.controls)), PATIENCE)
        await self.until(lambda: not self.master.state.joined)
        self.controls.clear()
        await self.master.stop()
        await self.store.close()

    async def until(self, true: Callable[[], bool]) -> None:
        async def poll() -> None:
            while not true():  # noqa: ASYNC110  # what is looked at has no event of its own
                await asyncio.sleep(0.001)

        await asyncio.wait_for(poll(), PATIENCE)

    async def process(self, role: Any, name: str, incarnation: str = "1", **hello: Any) -> Peer:
        token = hello.pop("token", "")
        if not token:
            token = f"token of {name} {incarnation} {len(self.controls)}"
            await self.master.processes.allow(name, role, token)
        return await Peer(self, Hello(role, name, token, rce.__version__, incarnation, **hello)).join()

    async def endpoint(self, name: str = "west", incarnation: str = "1", **hello: Any) -> Peer:
        return await self.process("robot", name, incarnation, url="ws://:1/", addresses=["tcp:x:1"], **hello)

    async def environment(self, machine: Peer) -> Peer:
        """Join with the token of the start that comes next at the machine."""
        spec = (await machine.next(StartEnvironment)).environment
        peer = await self.process("environment", spec.name, spec.run, token=spec.token)
        await peer.next(Sync)
        return peer


@pytest.fixture
async def platform(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Platform]:
    monkeypatch.setattr(attendance, "RETRY_FIRST", 0.0)
    platform = Platform(reactor, f"sqlite:///{tmp_path / 'master.db'}", LONG)
    await platform.start()
    await platform.master.users.add("ann", "secret")
    await platform.master.users.add("bob", "secret")
    yield platform
    await platform.stop()


def execute(endpoint: Peer, robot: str, command: m.Command, again: bool = False) -> Awaitable[Any]:
    return asyncio.ensure_future(endpoint.call(Execute.of(robot, command, again)))


async def login(endpoint: Peer, robot: str, resume: str = "") -> LoggedIn:
    user, _, tag = robot.partition("/")
    answer: LoggedIn = await endpoint.call(Login(user, tag, digest("secret"), resume))
    return answer


class Furnished:
    """Endpoint west with ann/r1, machine m1, environment ann/brain, and r1/pose connected with brain/pose."""

    def __init__(self, platform: Platform) -> None:
        self.platform = platform

    async def build(self) -> Furnished:
        self.west = await self.platform.endpoint()
        self.m1 = await self.platform.process("container", "m1", capacity=4)
        self.session = await login(self.west, "ann/r1")
        made = execute(self.west, "ann/r1", m.CreateContainer("brain"))
        self.brain = await self.platform.environment(self.m1)
        await made
        for command in (
            m.AddInterface("r1", "pose", "SubscriberConverter", "std_msgs/String"),
            m.AddInterface("brain", "pose", "PublisherInterface", "std_msgs/String"),
            m.Connect("r1/pose", "brain/pose"),
        ):
            await execute(self.west, "ann/r1", command)
        (link,) = self.platform.master.state.links
        self.link = link.name
        return self


@pytest.fixture
async def furnished(platform: Platform) -> Furnished:
    return await Furnished(platform).build()


# --- joining ----------------------------------------------------------------------------------------------------------


async def test_a_token_lets_in_once_and_the_credential_again(platform: Platform) -> None:
    await platform.master.processes.allow("west", "robot", "one-time")
    west = await platform.endpoint(token="one-time")
    with pytest.raises(Unauthorized):
        await platform.endpoint(token="one-time")
    again = await platform.endpoint(token=west.credential)
    assert again.credential == west.credential


@pytest.mark.parametrize(
    ("hello", "error"),
    [
        (Hello("robot", "west", "wrong", rce.__version__), Unauthorized),
        (Hello("container", "west", "t", rce.__version__), Unauthorized),
        (Hello("robot", "east", "t", rce.__version__), Unauthorized),
        (Hello("robot", "west", "t", "0.0.0"), InvalidRequest),
    ],
)
async def test_who_may_not_join(platform: Platform, hello: Hello, error: type[Exception]) -> None:
    await platform.master.processes.allow("west", "robot", "t")
    with pytest.raises(error):
        await Peer(platform, hello).join()
    assert not platform.master.state.joined


async def test_a_process_that_comes_twice_is_there_once(platform: Platform) -> None:
    first = await platform.endpoint()
    second = await platform.endpoint(token=first.credential)
    await asyncio.wait_for(first.control.lost, PATIENCE)
    assert "west" in platform.master.state.joined
    await second.next(Sync)


# --- environments -----------------------------------------------------------------------------------------------------


async def test_an_environment_is_acknowledged_when_it_is_in_line(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    assert (await m1.next(KeepEnvironments)).runs == []
    await login(west, "ann/r1")
    made = asyncio.ensure_future(execute(west, "ann/r1", m.CreateContainer("brain")))
    node = asyncio.ensure_future(execute(west, "ann/r1", m.AddNode("brain", "n", "p", "e")))
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.name == "ann/brain"
    assert not made.done()
    brain = await platform.process("environment", spec.name, token=spec.token)
    sync = await brain.next(Sync)
    assert [each.tag for each in sync.nodes] == ["n"]
    assert (await made, await node) == (Nothing(), Nothing())
    await execute(west, "ann/r1", m.DestroyContainer("brain"))
    assert (await m1.next(StopEnvironment)).name == "ann/brain"


async def test_a_start_that_fails_is_answered_and_taken_back(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    await login(west, "ann/r1")
    m1.refuse[StartEnvironment] = StartFailed("no image", image="x")
    with pytest.raises(StartFailed, match="no image") as raised:
        await execute(west, "ann/r1", m.CreateContainer("brain"))
    assert raised.value.info.fields == {"image": "x"}
    await m1.next(StopEnvironment)
    assert len(platform.master.state.environments) == 0


async def test_an_environment_that_does_not_come_up_is_answered_and_taken_back(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    await login(west, "ann/r1")
    made = execute(west, "ann/r1", m.CreateContainer("brain"))
    spec = (await m1.next(StartEnvironment)).environment
    await m1.call(EnvironmentDied(spec.name, spec.run, "exit status 1"))
    with pytest.raises(StartFailed, match="exit status 1"):
        await made
    await m1.next(StopEnvironment)
    assert len(platform.master.state.environments) == 0


async def test_a_dead_environment_gets_a_new_life(furnished: Furnished) -> None:
    platform, m1, west, brain = furnished.platform, furnished.m1, furnished.west, furnished.brain
    first = platform.master.state.environments["ann/brain"].run
    await m1.call(EnvironmentDied("ann/brain", first, "killed"))
    told = (await west.next(Tell)).status
    while told != m.EnvironmentEvent("brain", "lost", "killed"):
        told = (await west.next(Tell)).status
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.run != first
    with pytest.raises(Unauthorized):
        await platform.process("environment", "ann/brain", token=brain.credential)
    second = await platform.process("environment", spec.name, token=spec.token)
    assert [each.tag for each in (await second.next(Sync)).interfaces] == ["pose"]
    assert (await second.next(AddRoute)).route.link != furnished.link


async def test_a_dead_environment_that_fails_to_start_is_tried_again(furnished: Furnished) -> None:
    platform, m1 = furnished.platform, furnished.m1
    m1.refuse[StartEnvironment] = StartFailed("engine is down")
    run = platform.master.state.environments["ann/brain"].run
    await m1.call(EnvironmentDied("ann/brain", run, "killed"))
    runs = [(await m1.next(StartEnvironment)).environment.run for _ in range(3)]
    assert len({run, *runs}) == 4
    m1.refuse.clear()
    await platform.environment(m1)


async def test_who_asks_for_a_type_does_not_keep_an_environment_from_its_restart(furnished: Furnished) -> None:
    platform, m1 = furnished.platform, furnished.m1
    run = platform.master.state.environments["ann/brain"].run
    await m1.call(EnvironmentDied("ann/brain", run, "killed"))
    second = (await m1.next(StartEnvironment)).environment
    asked = asyncio.ensure_future(furnished.west.call(Describe("ann", "my_msgs/msg/A", False)))
    await platform.until(lambda: "Environment ann/brain" in platform.master._carrier._waiting)
    await m1.call(EnvironmentDied("ann/brain", second.run, "killed again"))
    await platform.environment(m1)
    assert isinstance(await asyncio.wait_for(asyncio.wait([asked]), PATIENCE), tuple)
    asked.exception()


async def test_restart_no_means_no(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    await login(west, "ann/r1")
    made = execute(west, "ann/r1", m.CreateContainer("brain", m.ContainerData(restart="no")))
    await platform.environment(m1)
    await made
    run = platform.master.state.environments["ann/brain"].run
    await m1.call(EnvironmentDied("ann/brain", run, "killed"))
    assert len(platform.master.state.environments) == 0


async def test_a_type_is_asked_of_the_users_environments(furnished: Furnished) -> None:
    answer = await furnished.west.call(Describe("ann", "my_msgs/msg/A", False))
    assert answer.texts == {"my_msgs/msg/A": "of ann/brain"}


# --- nodes, failures --------------------------------------------------------------------------------------------------


async def told(west: Peer, kind: type[Any]) -> Any:
    while True:
        tell = await west.next(Tell)
        for said in (tell.status, tell.error):
            if isinstance(said, kind):
                return said


async def test_a_node_that_ran_is_started_again(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    first = await furnished.brain.next(StartNode)
    await furnished.brain.call(NodeDied("n", -9, ["last words"], seconds=60))
    event = await told(furnished.west, m.NodeEvent)
    assert event == m.NodeEvent("brain", "n", -9, ["last words"])
    assert await furnished.brain.next(StartNode) == first


async def test_a_node_that_cannot_be_started_again_is_reported(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    furnished.brain.refuse[StartNode] = StartFailed("its file is gone")
    await furnished.brain.call(NodeDied("n", 1, [], seconds=60))
    assert (await told(furnished.west, ErrorInfo)).message == "its file is gone"
    assert len(furnished.platform.master.state.nodes) == 0


@pytest.mark.parametrize("died", [NodeDied("n", 0, [], seconds=60), NodeDied("n", 1, [], seconds=1)])
async def test_a_node_that_ended_or_never_worked_frees_its_tag(furnished: Furnished, died: NodeDied) -> None:
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    await furnished.brain.call(died)
    assert (await told(furnished.west, m.NodeEvent)).status == died.status
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "other"))


async def test_a_failing_interface_is_answered_and_taken_back(furnished: Furnished) -> None:
    furnished.brain.refuse[Bind] = NotFound("no such type")
    with pytest.raises(NotFound, match="no such type"):
        await execute(furnished.west, "ann/r1", m.AddInterface("brain", "x", "PublisherInterface", "a/B"))
    assert "ann/brain/x" not in furnished.platform.master.state.interfaces


async def test_a_defect_elsewhere_is_an_internal_error(furnished: Furnished, failures: list[Any]) -> None:
    furnished.brain.refuse[StartNode] = ZeroDivisionError("defect")
    with pytest.raises(Exception, match="defect while answering StartNode"):
        await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    assert [event["log_failure"].type for event in failures] == [ZeroDivisionError]
    failures.clear()


# --- robots, endpoints, links -----------------------------------------------------------------------------------------


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


async def test_a_robot_is_there_once(furnished: Furnished) -> None:
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/r1")
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/r1", resume="guess")
    with pytest.raises(AlreadyExists):
        await login(furnished.west, "ann/brain")
    await login(furnished.west, "bob/r1")


async def test_a_robot_resumes_at_another_endpoint(furnished: Furnished) -> None:
    east = await furnished.platform.endpoint("east")
    answer = await login(east, "ann/r1", furnished.session.token)
    assert answer.resumed
    assert [type(call).__name__ for call in east.arrived if not isinstance(call, Tell)] == [
        *("Sync", "Bind", "OpenLink", "AddRoute")
    ]
    assert (await furnished.west.next(DropRobot)).robot == "ann/r1"
    with pytest.raises(NotFound):
        await execute(furnished.west, "ann/r1", m.DestroyContainer("brain"))


async def test_a_login_stands_though_something_of_its_session_fails(furnished: Furnished) -> None:
    """A robot that was refused here would have a session and no token for it."""
    east = await furnished.platform.endpoint("east")
    east.refuse[Bind] = NotFound("unknown type")
    answer = await login(east, "ann/r1", furnished.session.token)
    assert answer.resumed
    assert (await told(east, ErrorInfo)).message == "unknown type"


async def test_robots_of_an_endpoint_that_stays_away_are_given_up(platform: Platform) -> None:
    platform.master.attendance.grace = 0.0
    west = await platform.endpoint()
    await login(west, "ann/r1")
    await west.leave()
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "west" not in platform.master.state.processes


async def test_an_endpoint_that_is_back_keeps_its_robots(furnished: Furnished) -> None:
    platform, west = furnished.platform, furnished.west
    await west.leave()
    (timer,) = platform.master.attendance._away.values()
    back = await platform.endpoint(token=west.credential, robots=["ann/r1"])
    sync = await back.next(Sync)
    assert sync.robots == ["ann/r1"]
    assert [(route.link, link.name) for route, link in zip(sync.routes, sync.links, strict=True)] == [
        (furnished.link, furnished.link)
    ]
    await execute(back, "ann/r1", m.Disconnect("r1/pose", "brain/pose"))
    await asyncio.wait([timer])
    assert timer.cancelled()


async def test_a_restarted_endpoint_has_lost_its_robots(furnished: Furnished) -> None:
    platform, west = furnished.platform, furnished.west
    await west.leave()
    platform.master.attendance.grace = 0.0
    back = await platform.endpoint(token=west.credential, incarnation="2")
    sync = await back.next(Sync)
    assert (sync.robots, sync.interfaces, sync.links) == ([], [], [])
    await furnished.brain.next(RemoveRoute)
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "ann/brain" in platform.master.state.environments


async def test_leaving_takes_the_robots_interfaces_only(furnished: Furnished) -> None:
    await furnished.west.call(Leave("ann/r1"))
    await furnished.brain.next(RemoveRoute)
    assert [each.key for each in furnished.platform.master.state.interfaces] == ["ann/brain/pose"]


async def test_a_lost_link_is_opened_anew_at_both_ends(furnished: Furnished) -> None:
    await furnished.brain.next(AddRoute)
    await furnished.brain.call(LinkLost(furnished.link, "reset"))
    opened = await furnished.brain.next(OpenLink)
    assert opened.link.name != furnished.link
    assert (await furnished.brain.next(AddRoute)).route.link == opened.link.name
    await furnished.west.call(LinkLost(furnished.link, "reset"))  # the other end saw it too: nothing more to do
    assert [link.name for link in furnished.platform.master.state.links] == [opened.link.name]


async def test_nobody_else_can_break_a_link_or_speak_to_others(furnished: Furnished) -> None:
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
    tell = await furnished.west.next(Tell)
    while tell.error is None:
        tell = await furnished.west.next(Tell)
    assert tell.robot == "bob/r1"


@pytest.mark.parametrize("command", [m.DestroyContainer("brain"), m.Disconnect("r1/pose", "brain/pose")])
async def test_another_users_things_are_not_found(furnished: Furnished, command: m.Command) -> None:
    await login(furnished.west, "bob/other")
    with pytest.raises(NotFound):
        await execute(furnished.west, "bob/other", command)


async def test_a_connection_is_completed_by_the_return_of_a_side(furnished: Furnished) -> None:
    """Its calls reach who is there; who was away hears of it in its Sync."""
    platform, west, brain = furnished.platform, furnished.west, furnished.brain
    await execute(west, "ann/r1", m.AddInterface("r1", "two", "SubscriberConverter", "a/B"))
    await execute(west, "ann/r1", m.AddInterface("brain", "two", "PublisherInterface", "a/B"))
    await brain.leave()
    connected = asyncio.ensure_future(execute(west, "ann/r1", m.Connect("r1/two", "brain/two")))
    await platform.until(lambda: "ann/r1/two ann/brain/two" in platform.master.state.connections)
    back = await platform.process("environment", "ann/brain", token=brain.credential)
    assert len((await back.next(Sync)).routes) == 1
    assert await connected == Nothing()


# --- the Master dies --------------------------------------------------------------------------------------------------


async def restart(furnished: Furnished) -> Platform:
    platform = furnished.platform
    await platform.stop()
    await platform.start()
    return platform


async def test_after_a_restart_all_is_as_it_was(furnished: Furnished) -> None:
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


async def test_after_a_restart_a_new_process_gets_links_anew(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    platform = await restart(furnished)
    m1 = await platform.process("container", "m1", capacity=4, token=furnished.m1.credential)
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.run != run
    west = await platform.endpoint(token=furnished.west.credential, robots=["ann/r1"])
    assert (await west.next(Sync)).routes == []
    await platform.process("environment", spec.name, token=spec.token)
    assert (await west.next(OpenLink)).link.name != furnished.link


async def test_who_does_not_come_back_after_a_restart_is_given_up(furnished: Furnished) -> None:
    furnished.platform.grace = 0.0
    platform = await restart(furnished)
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "ann/brain" in platform.master.state.environments


async def test_an_environment_that_was_removed_may_not_join(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.DestroyContainer("brain"))
    with pytest.raises(Unauthorized):
        await furnished.platform.process("environment", "ann/brain", token=furnished.brain.credential)


# --- services ---------------------------------------------------------------------------------------------------------


async def test_a_service_acts_for_a_user_as_a_robot_of_theirs(platform: Platform) -> None:
    maps = await platform.process("service", "map-service", url="http://:9020/")
    west = await platform.endpoint()
    assert await maps.call(Vouch("ann", digest("secret"))) == Person("ann", "user")
    grant = await maps.call(Delegate("ann", digest("secret")))
    lent = await maps.call(Borrow(grant.grant, 60))
    assert await west.call(Login("ann", "mapper", lent.key))
    for call in (Vouch("ann", lent.key), Delegate("ann", lent.key)):
        with pytest.raises(Forbidden):
            await maps.call(call)
    await maps.call(EndGrant(grant.grant))
    with pytest.raises(Unauthorized):
        await west.call(Login("ann", "other", lent.key))


async def test_a_service_acts_for_those_only_who_prove_themselves_and_may_use_robots(platform: Platform) -> None:
    maps = await platform.process("service", "map-service")
    await platform.master.users.add("root", "secret", "admin")
    key, _ = await platform.master.users.add_key("ann", "viewer")
    for call, error in (
        (Delegate("ann", digest("wrong")), Unauthorized),
        (Delegate("root", digest("secret")), Forbidden),
        (Vouch("", key), Forbidden),
        (Borrow("0" * 32, 60), Unauthorized),
    ):
        with pytest.raises(error):
            await maps.call(call)


async def test_what_a_service_tells_and_whom_it_is_refused_is_in_the_audit_log(platform: Platform) -> None:
    maps = await platform.process("service", "map-service")
    person = await maps.call(Vouch("ann", digest("secret"), "job.read", "10.0.0.1"))
    await maps.call(NoteDone(person, "job.cancel", "ann/0", "not_found", "10.0.0.1"))
    with pytest.raises(Unauthorized):
        await maps.call(Vouch("ann", digest("wrong"), "job.read", "10.0.0.1"))
    found = await platform.master.audit.find(Wanted(), None, 10)
    assert [(each.user, each.action, each.object, each.result, each.origin) for each in found] == [
        ("", "login", "ann", "unauthorized", "map-service 10.0.0.1"),
        ("ann", "job.cancel", "ann/0", "not_found", "map-service 10.0.0.1"),
    ]


async def test_a_key_that_is_revoked_while_the_master_is_away_closes_its_sockets(platform: Platform) -> None:
    west = await platform.endpoint()
    secret, key = await platform.master.users.add_key("ann")
    await west.call(Login("ann", "by_key", secret))
    await login(west, "ann/by_password")
    await platform.stop()
    await platform.start()
    await platform.master.users.keys.revoke("ann", key.id)
    await platform.master.guard.look_round()
    assert [robot.name for robot in platform.master.state.robots] == ["ann/by_password"]


async def test_only_services_act_for_users(platform: Platform) -> None:
    west = await platform.endpoint()
    with pytest.raises(InvalidRequest, match="does not answer"):
        await west.call(Delegate("ann", digest("secret")))


async def test_a_limit_that_an_environment_hit_is_told_to_its_user(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    await furnished.m1.call(LimitReached("ann/brain", "an earlier one", "late"))
    await furnished.m1.call(LimitReached("ann/brain", run, "memory"))
    assert await told(furnished.west, m.LimitEvent) == m.LimitEvent("environment brain: memory")
