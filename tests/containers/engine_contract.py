"""What every engine must do, whatever it runs on. A test class inherits it; its module has the fixture `world`."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from containers.engine import Ended, Engine, Life
from rce.calls.environments import EnvironmentSpec
from rce.errors import InvalidName, InvalidRequest, NoCapacity, StartFailed
from rce.messages import ContainerData

CAPACITY = 4
FEATURES = ("camera",)


def spec(name: str = "ann/map", run: int = 1, size: int = 1, features: tuple[str, ...] = ()) -> EnvironmentSpec:
    return EnvironmentSpec(name, f"{run:032x}", "token", ContainerData(size=size, specialFeatures=list(features)))


def with_options(**options: Any) -> EnvironmentSpec:
    return EnvironmentSpec("ann/map", spec().run, "token", ContainerData(**options))


class World(ABC):
    """The outside of an engine: what it runs on, and what a new engine on the same finds there."""

    @abstractmethod
    def engine(self, ended: Callable[[Ended], None]) -> Engine:
        """A new engine with CAPACITY and FEATURES, not yet open; the one before is closed or as if killed."""

    @abstractmethod
    def break_start(self, engine: Engine) -> None:
        """From now on the engine's starts fail."""

    @abstractmethod
    async def end(self, name: str) -> None:
        """The environment ends by itself, with status 3 after it has printed `last words`."""

    @abstractmethod
    def there(self) -> set[str]:
        """Names of all environments of which anything is there, alive or dead."""

    @abstractmethod
    def alive(self) -> dict[str, str]:
        """The runs of environments that are really alive, by name."""


class Endings:
    """Collects what an engine reports."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[Ended] = asyncio.Queue()

    def __call__(self, ended: Ended) -> None:
        self._queue.put_nowait(ended)

    async def next(self) -> Ended:
        return await asyncio.wait_for(self._queue.get(), 10)

    def none(self) -> bool:
        return self._queue.empty()


class Held:
    """Lets an engine's starts come as far as the environment exists, and holds them there."""

    def __init__(self, engine: Engine) -> None:
        self.reached = asyncio.Event()
        self.go = asyncio.Event()
        self._launch = engine.launch
        engine.launch = self.launch  # type: ignore[method-assign]

    async def launch(self, spec: EnvironmentSpec) -> None:
        await self._launch(spec)
        self.reached.set()
        await self.go.wait()


@asynccontextmanager
async def opened(world: World, endings: Endings) -> AsyncIterator[Engine]:
    """An engine that is open, and leaves nothing behind."""
    engine = world.engine(endings)
    try:
        await engine.open()
        yield engine
        await engine.keep([])
    finally:
        await engine.close()
    assert world.there() == set()


class EngineContract:
    # --- start and stop

    async def test_starts_and_stops(self, world: World, engine: Engine, endings: Endings) -> None:
        one = spec(size=2)
        await engine.start(one)
        assert engine.running() == {one.name: Life(one.run, 2)}
        assert world.alive() == {one.name: one.run}
        await engine.stop(one.name)
        assert engine.running() == {}
        assert world.there() == set()
        assert endings.none()

    async def test_measures_what_runs(self, world: World, engine: Engine) -> None:
        assert await engine.usage() == {}
        await engine.start(spec())
        used = await engine.usage()
        assert list(used) == ["ann/map"]
        assert used["ann/map"].seconds >= 0
        async with asyncio.timeout(10):
            while not used["ann/map"].memory:  # a process has none in the moment of its exec
                await asyncio.sleep(0.01)
                used = await engine.usage()
        await engine.stop("ann/map")
        assert await engine.usage() == {}

    async def test_a_second_start_changes_nothing(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec())
        await engine.start(spec())
        assert world.alive() == {"ann/map": spec().run}
        await world.end("ann/map")
        assert (await endings.next()).run == spec().run
        assert endings.none()

    async def test_starts_of_one_run_at_once_are_one(self, world: World, engine: Engine) -> None:
        held = Held(engine)
        both = [asyncio.create_task(engine.start(spec())) for _ in range(2)]
        await held.reached.wait()
        held.go.set()
        await asyncio.gather(*both)
        assert world.alive() == {"ann/map": spec().run}

    async def test_another_run_takes_the_place_of_the_first(
        self, world: World, engine: Engine, endings: Endings
    ) -> None:
        await engine.start(spec(run=1))
        await engine.start(spec(run=2))
        assert world.alive() == {"ann/map": spec(run=2).run}
        assert engine.running() == {"ann/map": Life(spec(run=2).run)}
        assert endings.none()

    async def test_another_run_takes_the_place_of_one_that_starts(self, world: World, engine: Engine) -> None:
        held = Held(engine)
        first = asyncio.create_task(engine.start(spec(run=1)))
        await held.reached.wait()
        second = asyncio.create_task(engine.start(spec(run=2)))
        with pytest.raises(StartFailed):
            await first
        held.go.set()
        await second
        assert world.alive() == {"ann/map": spec(run=2).run}

    async def test_stopping_what_is_not_there_is_well(self, engine: Engine) -> None:
        await engine.stop("ann/map")
        await engine.start(spec())
        await asyncio.gather(engine.stop("ann/map"), engine.stop("ann/map"))
        await engine.stop("ann/map")
        assert engine.running() == {}

    async def test_stop_cancels_a_start(self, world: World, engine: Engine, endings: Endings) -> None:
        held = Held(engine)
        start = asyncio.create_task(engine.start(spec()))
        await held.reached.wait()
        await engine.stop("ann/map")
        with pytest.raises(StartFailed, match="stopped while it started"):
            await start
        assert world.there() == set()
        assert engine.running() == {}
        assert endings.none()

    async def test_a_cancelled_caller_cancels_the_start(self, world: World, engine: Engine) -> None:
        held = Held(engine)
        start = asyncio.create_task(engine.start(spec()))
        await held.reached.wait()
        start.cancel()
        with pytest.raises(asyncio.CancelledError):
            await start
        await engine.stop("ann/map")  # waits for the clean-up
        assert world.there() == set()

    async def test_the_last_of_many_calls_counts(self, world: World, engine: Engine) -> None:
        calls = [engine.start(spec(run=1)), engine.stop("ann/map"), engine.start(spec(run=1)), engine.stop("ann/map")]
        calls += [engine.start(spec(run=2)), engine.stop("ann/map"), engine.start(spec(run=1))]
        results = await asyncio.gather(*calls, return_exceptions=True)
        assert results[-1] is None
        assert world.alive() == {"ann/map": spec(run=1).run}

    async def test_names_do_not_wait_for_each_other(self, world: World, engine: Engine) -> None:
        held = Held(engine)
        slow = asyncio.create_task(engine.start(spec("ann/map")))
        await held.reached.wait()
        engine.launch = held._launch  # type: ignore[method-assign]
        await engine.start(spec("ann/other", run=2))
        await engine.stop("ann/other")
        held.go.set()
        await slow
        assert world.alive() == {"ann/map": spec().run}

    async def test_keep_stops_all_others(self, world: World, engine: Engine, endings: Endings) -> None:
        for run, name in enumerate(("ann/a", "ann/b", "bob/a")):
            await engine.start(spec(name, run))
        held = Held(engine)
        starting = asyncio.create_task(engine.start(spec("bob/b", 9)))
        await held.reached.wait()
        await engine.keep([spec(run=1).run, spec(run=77).run])
        with pytest.raises(StartFailed):
            await starting
        assert world.there() == {"ann/b"}
        assert engine.running() == {"ann/b": Life(spec(run=1).run)}
        assert endings.none()

    # --- refusals and failures

    async def test_a_failed_start_leaves_nothing(self, world: World, engine: Engine, endings: Endings) -> None:
        world.break_start(engine)
        with pytest.raises(StartFailed, match="ann/map"):
            await engine.start(spec())
        assert world.there() == set()
        assert engine.running() == {}
        assert endings.none()

    async def test_capacity_is_counted_in_slots_also_of_what_starts(self, engine: Engine) -> None:
        await engine.start(spec("ann/a", 1, size=2))
        held = Held(engine)
        starting = asyncio.create_task(engine.start(spec("ann/b", 2, size=1)))
        await held.reached.wait()
        with pytest.raises(NoCapacity) as error:
            await engine.start(spec("ann/c", 3, size=2))
        assert error.value.info.fields == {"size": 2, "used": 3, "capacity": CAPACITY}
        held.go.set()
        await starting
        await engine.stop("ann/a")
        await engine.start(spec("ann/c", 3, size=3))

    async def test_a_new_run_may_use_the_slots_of_the_old(self, engine: Engine) -> None:
        await engine.start(spec(run=1, size=CAPACITY))
        await engine.start(spec(run=2, size=CAPACITY))
        assert engine.running() == {"ann/map": Life(spec(run=2).run, CAPACITY)}

    async def test_features_are_needed(self, engine: Engine) -> None:
        await engine.start(spec(features=("camera",)))
        with pytest.raises(NoCapacity, match="gpu"):
            await engine.start(spec("ann/b", 2, features=("camera", "gpu")))

    @pytest.mark.parametrize("name", ["ann", "../map", "ann/../..", "ann/a/b", "/map", "ann/"])
    async def test_names_that_are_none(self, engine: Engine, name: str) -> None:
        with pytest.raises(InvalidName):
            await engine.start(spec(name))
        with pytest.raises(InvalidName):
            await engine.stop(name)

    async def test_a_run_that_is_none(self, engine: Engine) -> None:
        with pytest.raises(InvalidRequest, match="32 hex"):
            await engine.start(EnvironmentSpec("ann/map", "../../etc", "token", ContainerData()))

    # --- ends by itself

    async def test_an_end_is_reported_when_nothing_is_left(
        self, world: World, engine: Engine, endings: Endings
    ) -> None:
        await engine.start(spec())
        await engine.start(spec("bob/map", 2))
        await world.end("ann/map")
        ended = await endings.next()
        assert (ended.name, ended.run, ended.status) == ("ann/map", spec().run, 3)
        assert "3" in ended.reason
        assert any("last words" in line for line in ended.lines)
        assert world.there() == {"bob/map"}
        assert engine.running() == {"bob/map": Life(spec(run=2).run)}

    async def test_starts_again_after_an_end(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec(run=1))
        await world.end("ann/map")
        await engine.start(spec(run=2))
        assert world.alive() == {"ann/map": spec(run=2).run}

    # --- a new task set

    async def test_what_runs_is_adopted(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec("ann/a", 1, size=2))
        await engine.start(spec("ann/b", 2))
        await engine.close()
        assert world.alive() == {"ann/a": spec(run=1).run, "ann/b": spec(run=2).run}
        later = Endings()
        again = world.engine(later)
        await again.open()
        assert again.running() == {"ann/a": Life(spec(run=1).run, 2), "ann/b": Life(spec(run=2).run)}
        await again.start(spec("ann/a", 1, size=2))
        await world.end("ann/a")
        ended = await later.next()
        assert (ended.name, ended.run) == ("ann/a", spec(run=1).run)
        await again.stop("ann/b")
        assert world.there() == set()
        await again.close()
        assert endings.none()

    async def test_what_died_meanwhile_is_removed(self, world: World, engine: Engine) -> None:
        await engine.start(spec("ann/a", 1))
        await engine.start(spec("ann/b", 2))
        await engine.close()
        await world.end("ann/a")
        again = world.engine(Endings())
        await again.open()
        assert again.running() == {"ann/b": Life(spec(run=2).run)}
        assert world.there() == {"ann/b"}
        await again.keep([])
        await again.close()

    async def test_close_cancels_starts(self, world: World, engine: Engine) -> None:
        held = Held(engine)
        start = asyncio.create_task(engine.start(spec()))
        await held.reached.wait()
        await engine.close()
        with pytest.raises(StartFailed):
            await start
        assert world.there() == set()
