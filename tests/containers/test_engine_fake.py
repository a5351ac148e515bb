"""The fakes: the well-behaved one keeps the contract, the others break it as their names say."""

import asyncio
from collections.abc import Callable

import pytest
from engine_contract import CAPACITY, FEATURES, Endings, EngineContract, World, spec

from containers.engine import Ended, Engine, Life
from containers.fake import AwayEngine, DyingEngine, FailingEngine, FakeEngine, FakeMachine, NeverEngine, SlowEngine
from containers.hollow import HollowEngine
from rce.calls.environments import EnvironmentSpec
from rce.errors import StartFailed


class FakeWorld(World):
    def __init__(self) -> None:
        self.machine = FakeMachine()

    def engine(self, ended: Callable[[Ended], None]) -> Engine:
        return FakeEngine(CAPACITY, FEATURES, ended, self.machine)

    def break_start(self, engine: Engine) -> None:
        async def launch(spec: EnvironmentSpec) -> None:
            self.machine.leftovers[spec.name] = spec.run
            raise StartFailed(f"environment {spec.name} did not start")

        engine.launch = launch  # type: ignore[method-assign]

    async def end(self, name: str) -> None:
        self.machine.end(name, 3)

    def there(self) -> set[str]:
        return {*self.machine.running, *self.machine.leftovers}

    def alive(self) -> dict[str, str]:
        return {name: life.run for name, life in self.machine.running.items()}


@pytest.fixture
def world() -> World:
    return FakeWorld()


class TestFakeEngine(EngineContract):
    async def test_a_half_started_one_is_removed(self, world: FakeWorld) -> None:
        world.machine.leftovers["ann/map"] = spec().run
        engine = world.engine(Endings())
        await engine.open()
        assert world.there() == set()
        await engine.close()


class Inside:
    """The endpoint of an environment that is no more than an entry in `present`."""

    def __init__(self, name: str, present: set[str]) -> None:
        self._name, self._present = name, present
        present.add(name)

    def close(self) -> None:
        self._present.discard(self._name)


class HollowWorld(FakeWorld):
    def __init__(self) -> None:
        super().__init__()
        self.present: set[str] = set()

    def engine(self, ended: Callable[[Ended], None]) -> Engine:
        async def inhabit(spec: EnvironmentSpec) -> Inside:
            return Inside(spec.name, self.present)

        return HollowEngine(CAPACITY, FEATURES, ended, self.machine, inhabit)


class TestHollowEngine(EngineContract):
    @pytest.fixture
    def world(self) -> World:
        return HollowWorld()

    async def test_an_endpoint_is_there_as_long_as_its_environment(self, world: HollowWorld) -> None:
        engine = world.engine(Endings())
        await engine.open()
        await engine.start(spec())
        assert world.present == {spec().name}
        await engine.stop(spec().name)
        assert world.present == set()
        await engine.close()


async def test_what_ends_while_others_are_adopted_is_reported() -> None:
    class Dying(FakeEngine):
        async def recover(self) -> dict[str, Life]:
            lives = await super().recover()
            self.machine.end("ann/map", 3)
            await asyncio.sleep(0)
            return lives

    machine, endings = FakeMachine(), Endings()
    machine.running["ann/map"] = Life(spec().run)
    engine = Dying(1, (), endings, machine)
    await engine.open()
    assert (await endings.next()).run == spec().run
    assert engine.running() == {}


async def test_slow_starts_when_told() -> None:
    engine = SlowEngine(1, (), Endings())
    await engine.open()
    start = asyncio.create_task(engine.start(spec()))
    await asyncio.sleep(0)
    assert engine.running() == {}
    engine.go.set()
    await start
    assert set(engine.running()) == {"ann/map"}


async def test_never_can_be_stopped() -> None:
    engine = NeverEngine(1, (), Endings())
    await engine.open()
    start = asyncio.create_task(engine.start(spec()))
    await asyncio.sleep(0)
    await engine.stop("ann/map")
    with pytest.raises(StartFailed):
        await start
    assert engine.machine.leftovers == {}


async def test_failing_leaves_nothing() -> None:
    engine = FailingEngine(1, (), Endings())
    await engine.open()
    with pytest.raises(StartFailed, match="no such image"):
        await engine.start(spec())
    assert engine.machine.leftovers == {}


async def test_dying_starts_and_ends() -> None:
    endings = Endings()
    engine = DyingEngine(1, (), endings)
    await engine.open()
    await engine.start(spec())
    assert (await endings.next()).status == 1
    assert engine.running() == {}


async def test_a_start_while_nobody_answers_fails_and_its_remains_go_later() -> None:
    """Unavailable would be for the Master to try again: the task set itself is there."""
    engine = AwayEngine(1, (), Endings())
    await engine.open()
    engine.away = True
    with pytest.raises(StartFailed, match="ann/map did not start: nobody answers"):
        await engine.start(spec())
    assert engine.machine.leftovers
    engine.away = False
    engine.stray("ann/map")
    await engine.close()
    assert not engine.machine.leftovers


async def test_what_runs_is_no_stray() -> None:
    engine = AwayEngine(1, (), Endings())
    await engine.open()
    await engine.start(spec())
    engine.stray("ann/map")
    await engine.stop("ann/other")
    assert list(engine.running()) == ["ann/map"]
    await engine.close()


async def test_limits_of_what_runs_are_told() -> None:
    engine, told = AwayEngine(1, (), Endings()), []
    engine.on_limit = lambda name, run, reason: told.append((name, run, reason))
    await engine.open()
    await engine.start(spec())
    engine.limit_hit("ann/map", spec(run=2).run, "of an earlier life")
    for _ in range(100):
        engine.limit_hit("ann/map", spec().run, "memory")
    assert told == [("ann/map", spec().run, "memory")]
    await engine.close()
