"""Fake engines: the contract of the ones that behave, and the faults of the others."""

import asyncio
from collections.abc import Callable

import pytest

from containers.engine import Engine, EnvironmentEnded, RunningEnvironment
from containers.fake import (
    DyingEngine,
    FailingEngine,
    FakeEngine,
    FakeMachine,
    NeverEngine,
    SlowEngine,
    UnavailableEngine,
)
from containers.hollow import HollowEngine
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import StartFailed
from tests.support.containers.engine_contract import CAPACITY, FEATURES, Endings, EngineContract, World, opened, spec


class FakeWorld(World):
    def __init__(self) -> None:
        self.machine = FakeMachine()

    def engine(self, ended: Callable[[EnvironmentEnded], None]) -> Engine:
        return FakeEngine(CAPACITY, FEATURES, ended, self.machine)

    def break_start(self, engine: Engine) -> None:
        async def launch(spec: EnvironmentSpec) -> None:
            self.machine.leftovers[spec.name] = spec.run
            raise StartFailed(f"environment {spec.name} did not start")

        engine.launch = launch  # type: ignore[method-assign]

    async def end(self, name: str) -> None:
        self.machine.end(name, 3)

    def remains(self) -> set[str]:
        return {*self.machine.running, *self.machine.leftovers}

    def alive(self) -> dict[str, str]:
        return {name: each.run for name, each in self.machine.running.items()}


@pytest.fixture
def world() -> World:
    return FakeWorld()


class TestFakeEngine(EngineContract):
    async def test_half_started_environment_is_removed(self, world: FakeWorld) -> None:
        world.machine.leftovers["ann/map"] = spec().run
        async with opened(world.engine(Endings())):
            assert world.remains() == set()


class FakeEndpoint:
    """Connection of an endpoint, which is an entry in `connected`."""

    def __init__(self, name: str, connected: set[str]) -> None:
        self._name, self._connected = name, connected
        connected.add(name)

    def close(self) -> None:
        self._connected.discard(self._name)


class HollowWorld(FakeWorld):
    def __init__(self) -> None:
        super().__init__()
        self.connected: set[str] = set()

    def engine(self, ended: Callable[[EnvironmentEnded], None]) -> Engine:
        async def join(spec: EnvironmentSpec) -> FakeEndpoint:
            return FakeEndpoint(spec.name, self.connected)

        return HollowEngine(CAPACITY, FEATURES, ended, self.machine, join)


class TestHollowEngine(EngineContract):
    @pytest.fixture
    def world(self) -> World:
        return HollowWorld()

    async def test_endpoint_is_connected_while_its_environment_runs(self, world: HollowWorld) -> None:
        async with opened(world.engine(Endings())) as engine:
            await engine.start(spec())
            assert world.connected == {spec().name}
            await engine.stop(spec().name)
            assert world.connected == set()


async def test_end_during_recovery_is_reported() -> None:
    class Dying(FakeEngine):
        async def recover(self) -> dict[str, RunningEnvironment]:
            adopted = await super().recover()
            self.machine.end("ann/map", 3)
            await asyncio.sleep(0)
            return adopted

    machine, endings = FakeMachine(), Endings()
    machine.running["ann/map"] = RunningEnvironment(spec().run)
    engine = Dying(1, (), endings, machine)
    await engine.open()
    assert (await endings.next()).run == spec().run
    assert engine.running() == {}


async def test_slow_engine_starts_when_released() -> None:
    engine = SlowEngine(1, (), Endings())
    await engine.open()
    start = asyncio.create_task(engine.start(spec()))
    await asyncio.sleep(0)
    assert engine.running() == {}
    engine.go.set()
    await start
    assert set(engine.running()) == {"ann/map"}


async def test_start_that_never_finishes_can_be_stopped() -> None:
    engine = NeverEngine(1, (), Endings())
    await engine.open()
    start = asyncio.create_task(engine.start(spec()))
    await asyncio.sleep(0)
    await engine.stop("ann/map")
    with pytest.raises(StartFailed):
        await start
    assert engine.machine.leftovers == {}


async def test_failing_start_leaves_nothing() -> None:
    engine = FailingEngine(1, (), Endings())
    await engine.open()
    with pytest.raises(StartFailed, match="no such image"):
        await engine.start(spec())
    assert engine.machine.leftovers == {}


async def test_dying_environment_starts_and_ends() -> None:
    endings = Endings()
    engine = DyingEngine(1, (), endings)
    await engine.open()
    await engine.start(spec())
    assert (await endings.next()).status == 1
    assert engine.running() == {}


async def test_start_on_unavailable_machine_fails_and_is_cleaned_up_later() -> None:
    """The error is not Unavailable, with which the Master would retry as if it could not reach the task set."""
    engine = UnavailableEngine(1, (), Endings())
    await engine.open()
    engine.unavailable = True
    with pytest.raises(StartFailed, match="ann/map did not start: the machine does not answer"):
        await engine.start(spec())
    assert engine.machine.leftovers
    engine.unavailable = False
    engine.report_stray("ann/map")
    await engine.close()
    assert not engine.machine.leftovers


async def test_running_environment_is_not_removed_as_stray() -> None:
    engine = UnavailableEngine(1, (), Endings())
    await engine.open()
    await engine.start(spec())
    engine.report_stray("ann/map")
    await engine.stop("ann/other")
    assert list(engine.running()) == ["ann/map"]
    await engine.close()


async def test_limit_is_reported_once_for_the_current_run() -> None:
    engine, reports = FakeEngine(1, (), Endings()), []
    engine.on_limit = lambda name, run, reason: reports.append((name, run, reason))
    await engine.open()
    await engine.start(spec())
    engine.report_limit("ann/map", spec(run=2).run, "of another run")
    for _ in range(100):
        engine.report_limit("ann/map", spec().run, "memory")
    assert reports == [("ann/map", spec().run, "memory")]
    await engine.close()
