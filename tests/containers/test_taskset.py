"""Task set and Master over a real control connection."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import pytest
from prometheus_client.parser import text_string_to_metric_families

from containers.engine import RunningEnvironment
from containers.fake import FailingEngine, FakeEngine, FakeMachine
from containers.taskset import TaskSet
from rce.control.calls.endpoints import StopNode
from rce.control.calls.environments import (
    EnvironmentDied,
    KeepEnvironments,
    LimitReached,
    StartEnvironment,
    StopEnvironment,
)
from rce.control.calls.joining import SetRemovedMachines
from rce.control.calls.watching import EnvironmentUsage, MeasureUsage, ReadMetrics, Usage
from rce.control.credential import Credential
from rce.errors import InvalidRequest, StartFailed, Unauthorized
from rce.net.certificates import Authority
from rce.net.tls import Tls
from rce.process.exposition import prometheus_text
from rce.process.metrics import Family, gauge_family
from tests.support.certificates import certify
from tests.support.containers.engine_contract import spec
from tests.support.containers.fake_master import WAIT, FakeMaster, joined


class Running:
    """Task set that runs on a fake machine."""

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


async def test_task_set_joins_and_serves(master: FakeMaster, tmp_path: Path) -> None:
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
        assert running.machine.running == {"ann/c": RunningEnvironment(spec(run=3).run)}


async def test_usage_is_reported(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec("ann/a", 1)))
        running.machine.used["ann/a"] = EnvironmentUsage(1.5, 2000)
        assert await control.call(MeasureUsage()) == Usage({"ann/a": EnvironmentUsage(1.5, 2000)})


class EngineWithNodes(FakeEngine):
    """Engine with a process on a node, which has metrics of its own."""

    async def metrics(self) -> dict[str, list[Family]]:
        return {"n1": [gauge_family("rce_info", "", ["role", "version"], {("agent", "1"): 1})]}


@pytest.mark.parametrize(("engine", "nodes"), [(FakeEngine, [None]), (EngineWithNodes, ["", "n1"])])
async def test_metrics_include_those_of_agents(
    master: FakeMaster, tmp_path: Path, engine: type[FakeEngine], nodes: list[str | None]
) -> None:
    async with Running(master, tmp_path, engine) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec("ann/a", 1)))
        running.machine.used["ann/a"] = EnvironmentUsage(1.5, 2000)
        families = (await control.call(ReadMetrics())).families
    samples = [
        sample
        for family in text_string_to_metric_families(prometheus_text(families).decode())
        for sample in family.samples
    ]
    assert [each.labels.get("node") for each in samples if each.name == "rce_info"] == nodes
    values = {(each.name, each.labels.get("state")): each.value for each in samples}
    assert values["rce_slots", "used"] == 1
    assert values["rce_environment_cpu_seconds_total", None] == 1.5
    assert values["rce_relay_connections", "taken"] == 0


class EngineOnHosts(FakeEngine):
    """Engine of several hosts, with a relay on each."""

    sockets = "/e/{run}"
    hosts: ClassVar[dict[str, str]] = {}
    removed: ClassVar[list[Mapping[str, float]]] = []

    @property
    def relays(self) -> dict[str, str]:
        return dict(self.hosts)

    def set_removed_machines(self, machines: Mapping[str, float]) -> None:
        self.removed.append(machines)


async def test_task_set_tells_how_its_environments_are_dialled(
    master: FakeMaster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EngineOnHosts, "hosts", {"n1": "n1:1"})
    async with Running(master, tmp_path, EngineOnHosts) as running:
        await joined(master)
        hello = master.hellos[-1]
        assert (hello.host, hello.sockets, hello.relays, hello.addresses) == ("", "/e/{run}", {"n1": "n1:1"}, [])
        engine = running.task_set._engine
        engine.on_relays()  # as nothing has changed, nothing is reported
        monkeypatch.setattr(EngineOnHosts, "hosts", {"n1": "n1:1", "n2": "n2:1"})
        engine.on_relays()
        assert (await asyncio.wait_for(master.relays.get(), WAIT)).relays == {"n1": "n1:1", "n2": "n2:1"}
        assert master.relays.empty()


async def test_removals_of_machines_reach_the_certificates_and_the_engine(
    master: FakeMaster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EngineOnHosts, "removed", [])
    async with Running(master, tmp_path, EngineOnHosts) as running:
        control = await joined(master)
        await control.call(SetRemovedMachines({"m7": 5.0}))  # without TLS there are no certificates
        tls = running.task_set._tls = Tls(certify(tmp_path / "tls", Authority.make("test"), ["127.0.0.1"]))
        await control.call(SetRemovedMachines({"m8": 5.0}))
        assert tls.is_removed("m8", 4.0)
        assert EngineOnHosts.removed == [{"m7": 5.0}, {"m8": 5.0}]


async def test_failed_start_has_a_reason(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path, FailingEngine):
        control = await joined(master)
        with pytest.raises(StartFailed, match="ann/map: no such image") as error:
            await control.call(StartEnvironment(spec()))
        assert error.value.info.fields == {"lines": ["pull access denied"]}


async def test_environment_that_is_stopped_while_its_packages_are_fetched_does_not_start(
    master: FakeMaster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        fetching, fetched = asyncio.Event(), asyncio.Event()

        async def provide(run: str, digests: object) -> None:
            fetching.set()
            await fetched.wait()

        monkeypatch.setattr(running.task_set._packages, "provide", provide)
        start = asyncio.create_task(control.call(StartEnvironment(spec())))
        await fetching.wait()
        await control.call(StopEnvironment(spec().name))
        fetched.set()
        with pytest.raises(StartFailed, match="was stopped while it started"):
            await start
        assert not running.task_set._engine.running()


async def test_unknown_call_is_refused(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path):
        control = await joined(master)
        with pytest.raises(InvalidRequest, match="StopNode"):
            await control.call(StopNode("n"))


async def test_end_is_reported_with_last_lines(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec()))
        running.machine.end("ann/map", 3)
        died = await asyncio.wait_for(master.deaths.get(), WAIT)
        assert died == EnvironmentDied("ann/map", spec().run, "ended with status 3\nlast words of ann/map")


async def test_task_set_rejoins_a_restarted_master(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec("ann/a", 1)))
        await control.call(StartEnvironment(spec("ann/b", 2)))
        await master.down()
        async with asyncio.timeout(WAIT):
            while running.task_set._link.connected:  # noqa: ASYNC110  # it has no event of its own
                await asyncio.sleep(0.001)
        running.machine.end("ann/b", 1)
        await master.up()
        control = await joined(master)
        first, second = master.hellos
        assert second.token == "credential"
        assert second.incarnation == first.incarnation != ""
        assert second.environments["ann/a"] == spec(run=1).run
        died = await asyncio.wait_for(master.deaths.get(), WAIT)  # the report waited for the Master
        assert died.name == "ann/b"
        await control.call(StopEnvironment("ann/a"))
        assert running.machine.running == {}


async def test_task_set_waits_for_the_master(master: FakeMaster, tmp_path: Path) -> None:
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


async def test_environments_are_stopped_at_exit_on_request(master: FakeMaster, tmp_path: Path) -> None:
    running = Running(master, tmp_path)
    task = asyncio.create_task(running.task_set.run(stop_environments=True))
    await (await joined(master)).call(StartEnvironment(spec()))
    task.cancel()
    await asyncio.wait({task})
    assert running.machine.running == {}


async def test_refused_token_ends_the_task_set(master: FakeMaster, tmp_path: Path) -> None:
    master.accepted.clear()
    running = Running(master, tmp_path)
    with pytest.raises(Unauthorized, match="m1: this token is not known"):
        await running.task_set.run(stop_environments=False)
    assert not running.file.exists()


async def test_token_is_used_if_the_credential_is_refused(master: FakeMaster, tmp_path: Path) -> None:
    (tmp_path / "credential").write_text("of an earlier Master")
    async with Running(master, tmp_path) as running:
        await (await joined(master)).call(ReadMetrics())  # when it is answered, the task set has received its welcome
        assert [hello.token for hello in master.hellos] == ["of an earlier Master", "token"]
        assert running.file.read_text() == "credential"
        assert running.file.stat().st_mode & 0o777 == 0o600


async def test_limit_is_reported(master: FakeMaster, tmp_path: Path) -> None:
    async with Running(master, tmp_path) as running:
        control = await joined(master)
        await control.call(StartEnvironment(spec()))
        assert running.machine.watcher is not None
        running.machine.watcher.report_limit("ann/map", spec().run, "memory")
        report = await asyncio.wait_for(master.limits.get(), WAIT)
        assert report == LimitReached("ann/map", spec().run, "memory")
