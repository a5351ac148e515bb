"""The task set and a Master over a real control connection."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
from engine_contract import spec
from prometheus_client.parser import text_string_to_metric_families
from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort

from containers.engine import Life
from containers.fake import FailingEngine, FakeEngine, FakeMachine
from containers.taskset import TaskSet
from rce.calls.call import Nothing, Ping
from rce.calls.endpoints import StopNode
from rce.calls.environments import EnvironmentDied, KeepEnvironments, LimitReached, StartEnvironment, StopEnvironment
from rce.calls.joining import Hello, Welcome
from rce.calls.watching import MeasureUsage, ReadMetrics, Usage, Used
from rce.control import Control, Handlers, listen
from rce.credential import Credential
from rce.errors import InvalidRequest, StartFailed, Unauthorized
from rce.exposition import text
from rce.metrics import Family, gauge


class FakeMaster:
    """Lets in who presents the token or the credential, and remembers what it hears."""

    def __init__(self, reactor: ReactorBase) -> None:
        self.reactor = reactor
        self.accepted = {"token", "credential"}
        self.hellos: list[Hello] = []
        self.joined: asyncio.Queue[Control] = asyncio.Queue()
        self.deaths: asyncio.Queue[EnvironmentDied] = asyncio.Queue()
        self.limits: asyncio.Queue[LimitReached] = asyncio.Queue()
        self.controls: list[Control] = []
        self.number = 0
        self._port: IListeningPort | None = None

    async def up(self) -> None:
        self._port = await listen(self.reactor, f"tcp:{self.number}:interface=127.0.0.1", self)
        self.number = self._port.getHost().port  # type: ignore[misc]  # zope declares it without self

    async def down(self) -> None:
        if self._port is not None:
            stopped = self._port.stopListening()  # type: ignore[misc]
            if stopped is not None:
                await stopped.asFuture(asyncio.get_running_loop())
        for control in self.controls:
            control.close()
            await control.lost
        self.controls.clear()

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        self.hellos.append(hello)
        if hello.token not in self.accepted:
            raise Unauthorized(f"{hello.name}: this token is not known")
        handlers = Handlers()
        handlers.on(EnvironmentDied, self._died)
        handlers.on(LimitReached, self._limit)
        return Welcome("credential"), handlers, self._joined

    def _joined(self, control: Control) -> None:
        self.controls.append(control)
        self.joined.put_nowait(control)

    async def _limit(self, call: LimitReached) -> Nothing:
        self.limits.put_nowait(call)
        return Nothing()

    async def _died(self, call: EnvironmentDied) -> Nothing:
        self.deaths.put_nowait(call)
        return Nothing()


@pytest.fixture
async def master(reactor: ReactorBase) -> AsyncIterator[FakeMaster]:
    master = FakeMaster(reactor)
    await master.up()
    yield master
    await master.down()


class Running:
    """A task set that runs, on a fake machine."""

    def __init__(self, master: FakeMaster, directory: Path, engine: type[FakeEngine] = FakeEngine) -> None:
        self.machine = FakeMachine()
        self.file = directory / "credential"
        self.task_set = TaskSet(
            master.reactor,
            f"tcp:127.0.0.1:{master.number}",
            "m1",
            Credential(self.file, "token"),
            lambda ended: engine(4, ("gpu",), ended, self.machine),
            directory / "packages",
        )

    async def __aenter__(self) -> Running:
        self.task = asyncio.create_task(self.task_set.run(stop_environments=False))
        return self

    async def __aexit__(self, *_: object) -> None:
        self.task.cancel()
        await asyncio.wait({self.task})


async def joined(master: FakeMaster) -> Control:
    return await asyncio.wait_for(master.joined.get(), 10)


async def test_joins_and_serves(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        hello = master.hellos[0]
        assert (hello.role, hello.name, hello.token, hello.capacity) == ("container", "m1", "token", 4)
        assert (hello.features, hello.environments) == (["gpu"], {})
        await control.call(StartEnvironment(spec("ann/a", 1)))
        await control.call(StartEnvironment(spec("ann/b", 2)))
        await control.call(StartEnvironment(spec("ann/c", 3)))
        await control.call(StopEnvironment("ann/a"))
        assert set(running.machine.running) == {"ann/b", "ann/c"}
        await control.call(KeepEnvironments([spec(run=3).run]))
        assert running.machine.running == {"ann/c": Life(spec(run=3).run)}


async def test_tells_what_its_environments_use(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec("ann/a", 1)))
        running.machine.used["ann/a"] = Used(1.5, 2000)
        assert await control.call(MeasureUsage()) == Usage({"ann/a": Used(1.5, 2000)})


class OnNodes(FakeEngine):
    """On a machine with processes of its own."""

    async def metrics(self) -> dict[str, list[Family]]:
        return {"n1": [gauge("rce_info", "", ["role", "version"], {("agent", "1"): 1})]}


@pytest.mark.parametrize(("engine", "nodes"), [(FakeEngine, [None]), (OnNodes, ["", "n1"])])
async def test_tells_its_metrics_and_those_of_its_agents(
    master: FakeMaster, tmp_path: Path, engine: type[FakeEngine], nodes: list[str | None]
) -> None:
    async with Running(master, tmp_path, engine) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec("ann/a", 1)))
        running.machine.used["ann/a"] = Used(1.5, 2000)
        told = (await control.call(ReadMetrics())).families
    samples = [sample for family in text_string_to_metric_families(text(told).decode()) for sample in family.samples]
    assert [each.labels.get("node") for each in samples if each.name == "rce_info"] == nodes
    values = {(each.name, each.labels.get("state")): each.value for each in samples}
    assert values["rce_slots", "used"] == 1
    assert values["rce_environment_cpu_seconds_total", None] == 1.5
    assert values["rce_relay_connections", "taken"] == 0


async def test_a_failed_start_comes_with_its_reason(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path, FailingEngine):
        control = await joined(master)
        with pytest.raises(StartFailed, match="ann/map: no such image") as error:
            await control.call(StartEnvironment(spec()))
        assert error.value.info.fields == {"lines": ["pull access denied"]}


async def test_what_a_task_set_does_not_answer(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path):
        control = await joined(master)
        with pytest.raises(InvalidRequest, match="StopNode"):
            await control.call(StopNode("n"))


async def test_an_end_is_reported_with_the_last_lines(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec()))
        running.machine.end("ann/map", 3)
        died = await asyncio.wait_for(master.deaths.get(), 10)
        assert died == EnvironmentDied("ann/map", spec().run, "ended with status 3\nlast words of ann/map")


async def test_master_goes_and_comes_back(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec("ann/a", 1)))
        await control.call(StartEnvironment(spec("ann/b", 2)))
        await master.down()
        running.machine.end("ann/b", 1)
        await master.up()
        control = await joined(master)
        first, second = master.hellos
        assert second.token == "credential"
        assert second.incarnation == first.incarnation != ""
        assert second.environments["ann/a"] == spec(run=1).run
        died = await asyncio.wait_for(master.deaths.get(), 10)  # reported late: it waited for the Master
        assert died.name == "ann/b"
        await control.call(StopEnvironment("ann/a"))
        assert running.machine.running == {}


async def test_a_master_that_is_not_up_yet_is_waited_for(master: FakeMaster, tmp_path: Path) -> None:
    await master.down()
    async with Running(master, tmp_path):
        await asyncio.sleep(0)
        await master.up()
        await joined(master)


async def test_environments_are_adopted_by_the_next_task_set(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        await (await joined(master)).call(StartEnvironment(spec()))
    again = Running(master, tmp_path)
    again.machine.running = running.machine.running
    async with again:
        await joined(master)
        assert master.hellos[-1].environments == {"ann/map": spec().run}
        assert master.hellos[-1].incarnation != master.hellos[0].incarnation


async def test_environments_are_stopped_at_the_end_if_wanted(master: FakeMaster, tmp_path: Path) -> None:
    running = Running(master, tmp_path)
    task = asyncio.create_task(running.task_set.run(stop_environments=True))
    await (await joined(master)).call(StartEnvironment(spec()))
    task.cancel()
    await asyncio.wait({task})
    assert running.machine.running == {}


async def test_a_refused_token_ends_the_task_set(master: FakeMaster, tmp_path: Path) -> None:
    master.accepted.clear()
    running = Running(master, tmp_path)
    with pytest.raises(Unauthorized, match="m1: this token is not known"):
        await running.task_set.run(stop_environments=False)
    assert not running.file.exists()


async def test_a_refused_credential_gives_way_to_the_token(master: FakeMaster, tmp_path: Path) -> None:
    (tmp_path / "credential").write_text("of a Master that is no more")
    async with Running(master, tmp_path) as running:
        await (await joined(master)).call(Ping())  # by its answer the task set has its welcome
        assert [hello.token for hello in master.hellos] == ["of a Master that is no more", "token"]
        assert running.file.read_text() == "credential"
        assert running.file.stat().st_mode & 0o777 == 0o600


async def test_a_limit_that_was_hit_is_reported(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec()))
        assert running.machine.watcher is not None
        running.machine.watcher.limit_hit("ann/map", spec().run, "memory")
        told = await asyncio.wait_for(master.limits.get(), 10)
        assert told == LimitReached("ann/map", spec().run, "memory")
