"""Contract suite of engines: tests that every engine must pass.

A test class of the engine inherits `EngineContract`, and its module has a fixture `world`, which gives the tests access
to the machine that the engine runs on. See docs/guides/write-an-engine.md.
"""

from __future__ import annotations

import asyncio
import secrets
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, TypeVar

import pytest

from containers.engine import Engine, EnvironmentEnded, RunningEnvironment
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import InvalidName, InvalidRequest, NoCapacity, StartFailed
from rce.protocol.messages import ContainerData

CAPACITY = 4
FEATURES = ("camera",)
# Runs are unique on a machine: the process engine kills every process of a run, also those in containers of other tests
# that run at the same time.
RUNS = secrets.token_hex(8)
E = TypeVar("E", bound=Engine)


def spec(name: str = "ann/map", run: int = 1, size: int = 1, features: tuple[str, ...] = ()) -> EnvironmentSpec:
    """Return the specification of an environment; `run` is the number of its run among those of this test process."""
    options = ContainerData(size=size, specialFeatures=list(features))
    return EnvironmentSpec(name, f"{RUNS}{run:016x}", "token", options)


def with_options(**options: Any) -> EnvironmentSpec:
    return EnvironmentSpec("ann/map", spec().run, "token", ContainerData(**options))


class World(ABC):
    """The machine that an engine runs on, with the environments that a new engine finds there."""

    @abstractmethod
    def engine(self, ended: Callable[[EnvironmentEnded], None]) -> Engine:
        """Return a new engine with CAPACITY and FEATURES, not yet open; the one before is closed or as if killed."""

    @abstractmethod
    def break_start(self, engine: Engine) -> None:
        """Make all further starts of an engine fail."""

    @abstractmethod
    async def end(self, name: str) -> None:
        """Make an environment print `last words` and end by itself with status 3."""

    @abstractmethod
    def remains(self) -> set[str]:
        """Return the names of all environments of which anything exists, alive or dead."""

    @abstractmethod
    def alive(self) -> dict[str, str]:
        """Return the runs of environments that are really alive, by name."""


class Endings:
    """The callback `ended` of an engine, which collects its reports."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[EnvironmentEnded] = asyncio.Queue()

    def __call__(self, ended: EnvironmentEnded) -> None:
        self._queue.put_nowait(ended)

    async def next(self, seconds: float = 60) -> EnvironmentEnded:
        return await asyncio.wait_for(self._queue.get(), seconds)

    def none(self) -> bool:
        return self._queue.empty()


class PausedLaunch:
    """Pauses the launches of an engine when their environments exist, until `resume` is set."""

    def __init__(self, engine: Engine) -> None:
        self.reached = asyncio.Event()
        self.resume = asyncio.Event()
        self.original = engine.launch
        engine.launch = self.launch  # type: ignore[method-assign]

    async def launch(self, spec: EnvironmentSpec) -> None:
        await self.original(spec)
        self.reached.set()
        await self.resume.wait()


@asynccontextmanager
async def opened(engine: E) -> AsyncIterator[E]:
    """Open an engine; stop its environments and close it in any case.

    An engine left open by a failed test would keep its ports and environments, and so fail all tests after it.
    """
    try:
        await engine.open()
        try:
            yield engine
        finally:
            await engine.keep([])
    finally:
        await engine.close()


class EngineContract:
    # --- start and stop -----------------------------------------------------------------------------------------------

    async def test_environment_starts_and_stops(self, world: World, engine: Engine, endings: Endings) -> None:
        one = spec(size=2)
        await engine.start(one)
        assert engine.running() == {one.name: RunningEnvironment(one.run, 2)}
        assert world.alive() == {one.name: one.run}
        await engine.stop(one.name)
        assert engine.running() == {}
        assert world.remains() == set()
        assert endings.none()

    async def test_usage_of_running_environments_is_measured(self, world: World, engine: Engine) -> None:
        assert await engine.usage() == {}
        await engine.start(spec())
        used = await engine.usage()
        assert list(used) == ["ann/map"]
        assert used["ann/map"].seconds >= 0
        async with asyncio.timeout(60):
            while not used["ann/map"].memory:  # a process has none during its exec
                await asyncio.sleep(0.01)
                used = await engine.usage()
        await engine.stop("ann/map")
        assert await engine.usage() == {}

    async def test_second_start_of_a_run_changes_nothing(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec())
        await engine.start(spec())
        assert world.alive() == {"ann/map": spec().run}
        await world.end("ann/map")
        assert (await endings.next()).run == spec().run
        assert endings.none()

    async def test_concurrent_starts_of_one_run_are_joined(self, world: World, engine: Engine) -> None:
        paused = PausedLaunch(engine)
        both = [asyncio.create_task(engine.start(spec())) for _ in range(2)]
        await paused.reached.wait()
        paused.resume.set()
        await asyncio.gather(*both)
        assert world.alive() == {"ann/map": spec().run}

    async def test_new_run_replaces_a_running_one(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec(run=1))
        await engine.start(spec(run=2))
        assert world.alive() == {"ann/map": spec(run=2).run}
        assert engine.running() == {"ann/map": RunningEnvironment(spec(run=2).run)}
        assert endings.none()

    async def test_new_run_replaces_a_starting_one(self, world: World, engine: Engine) -> None:
        paused = PausedLaunch(engine)
        first = asyncio.create_task(engine.start(spec(run=1)))
        await paused.reached.wait()
        second = asyncio.create_task(engine.start(spec(run=2)))
        with pytest.raises(StartFailed):
            await first
        paused.resume.set()
        await second
        assert world.alive() == {"ann/map": spec(run=2).run}

    async def test_stopping_an_unknown_environment_does_nothing(self, engine: Engine) -> None:
        await engine.stop("ann/map")
        await engine.start(spec())
        await asyncio.gather(engine.stop("ann/map"), engine.stop("ann/map"))
        await engine.stop("ann/map")
        assert engine.running() == {}

    async def test_stop_cancels_a_start(self, world: World, engine: Engine, endings: Endings) -> None:
        paused = PausedLaunch(engine)
        start = asyncio.create_task(engine.start(spec()))
        await paused.reached.wait()
        await engine.stop("ann/map")
        with pytest.raises(StartFailed, match="stopped while it started"):
            await start
        assert world.remains() == set()
        assert engine.running() == {}
        assert endings.none()

    async def test_cancelled_caller_cancels_the_start(self, world: World, engine: Engine) -> None:
        paused = PausedLaunch(engine)
        start = asyncio.create_task(engine.start(spec()))
        await paused.reached.wait()
        start.cancel()
        with pytest.raises(asyncio.CancelledError):
            await start
        await engine.stop("ann/map")  # returns after the clean-up
        assert world.remains() == set()

    async def test_last_of_many_calls_decides(self, world: World, engine: Engine) -> None:
        calls = [engine.start(spec(run=1)), engine.stop("ann/map"), engine.start(spec(run=1)), engine.stop("ann/map")]
        calls += [engine.start(spec(run=2)), engine.stop("ann/map"), engine.start(spec(run=1))]
        results = await asyncio.gather(*calls, return_exceptions=True)
        assert results[-1] is None
        assert world.alive() == {"ann/map": spec(run=1).run}

    async def test_operations_on_different_names_are_concurrent(self, world: World, engine: Engine) -> None:
        paused = PausedLaunch(engine)
        slow = asyncio.create_task(engine.start(spec("ann/map")))
        await paused.reached.wait()
        engine.launch = paused.original  # type: ignore[method-assign]
        await engine.start(spec("ann/other", run=2))
        await engine.stop("ann/other")
        paused.resume.set()
        await slow
        assert world.alive() == {"ann/map": spec().run}

    async def test_keep_stops_all_others(self, world: World, engine: Engine, endings: Endings) -> None:
        for run, name in enumerate(("ann/a", "ann/b", "bob/a")):
            await engine.start(spec(name, run))
        paused = PausedLaunch(engine)
        starting = asyncio.create_task(engine.start(spec("bob/b", 9)))
        await paused.reached.wait()
        await engine.keep([spec(run=1).run, spec(run=77).run])
        with pytest.raises(StartFailed):
            await starting
        assert world.remains() == {"ann/b"}
        assert engine.running() == {"ann/b": RunningEnvironment(spec(run=1).run)}
        assert endings.none()

    # --- refusals and failures ----------------------------------------------------------------------------------------

    async def test_failed_start_leaves_nothing(self, world: World, engine: Engine, endings: Endings) -> None:
        world.break_start(engine)
        with pytest.raises(StartFailed, match="ann/map"):
            await engine.start(spec())
        assert world.remains() == set()
        assert engine.running() == {}
        assert endings.none()

    async def test_slots_of_starting_environments_count(self, engine: Engine) -> None:
        await engine.start(spec("ann/a", 1, size=2))
        paused = PausedLaunch(engine)
        starting = asyncio.create_task(engine.start(spec("ann/b", 2, size=1)))
        await paused.reached.wait()
        with pytest.raises(NoCapacity) as error:
            await engine.start(spec("ann/c", 3, size=2))
        assert error.value.info.fields == {"size": 2, "used": 3, "capacity": CAPACITY}
        paused.resume.set()
        await starting
        await engine.stop("ann/a")
        await engine.start(spec("ann/c", 3, size=3))

    async def test_new_run_may_use_the_slots_of_the_old(self, engine: Engine) -> None:
        await engine.start(spec(run=1, size=CAPACITY))
        await engine.start(spec(run=2, size=CAPACITY))
        assert engine.running() == {"ann/map": RunningEnvironment(spec(run=2).run, CAPACITY)}

    async def test_missing_feature_is_refused(self, engine: Engine) -> None:
        await engine.start(spec(features=("camera",)))
        with pytest.raises(NoCapacity, match="gpu"):
            await engine.start(spec("ann/b", 2, features=("camera", "gpu")))

    @pytest.mark.parametrize("name", ["ann", "../map", "ann/../..", "ann/a/b", "/map", "ann/"])
    async def test_invalid_name_is_refused(self, engine: Engine, name: str) -> None:
        with pytest.raises(InvalidName):
            await engine.start(spec(name))
        with pytest.raises(InvalidName):
            await engine.stop(name)

    async def test_malformed_run_is_refused(self, engine: Engine) -> None:
        with pytest.raises(InvalidRequest, match="32 hex"):
            await engine.start(EnvironmentSpec("ann/map", "../../etc", "token", ContainerData()))

    # --- environments that end by themselves --------------------------------------------------------------------------

    async def test_end_is_reported_after_removal(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec())
        await engine.start(spec("bob/map", 2))
        await world.end("ann/map")
        ended = await endings.next()
        assert (ended.name, ended.run, ended.status) == ("ann/map", spec().run, 3)
        assert "3" in ended.reason
        assert any("last words" in line for line in ended.lines)
        assert world.remains() == {"bob/map"}
        assert engine.running() == {"bob/map": RunningEnvironment(spec(run=2).run)}

    async def test_environment_starts_again_after_an_end(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec(run=1))
        await world.end("ann/map")
        await engine.start(spec(run=2))
        assert world.alive() == {"ann/map": spec(run=2).run}

    # --- restart of the task set --------------------------------------------------------------------------------------

    async def test_running_environments_are_adopted(self, world: World, engine: Engine, endings: Endings) -> None:
        await engine.start(spec("ann/a", 1, size=2))
        await engine.start(spec("ann/b", 2))
        await engine.close()
        assert world.alive() == {"ann/a": spec(run=1).run, "ann/b": spec(run=2).run}
        later = Endings()
        async with opened(world.engine(later)) as again:
            assert again.running() == {
                "ann/a": RunningEnvironment(spec(run=1).run, 2),
                "ann/b": RunningEnvironment(spec(run=2).run),
            }
            await again.start(spec("ann/a", 1, size=2))
            await world.end("ann/a")
            ended = await later.next()
            assert (ended.name, ended.run) == ("ann/a", spec(run=1).run)
            await again.stop("ann/b")
            assert world.remains() == set()
        assert endings.none()

    async def test_environment_that_died_meanwhile_is_removed(self, world: World, engine: Engine) -> None:
        await engine.start(spec("ann/a", 1))
        await engine.start(spec("ann/b", 2))
        await engine.close()
        await world.end("ann/a")
        async with opened(world.engine(Endings())) as again:
            assert again.running() == {"ann/b": RunningEnvironment(spec(run=2).run)}
            assert world.remains() == {"ann/b"}

    async def test_close_cancels_starts(self, world: World, engine: Engine) -> None:
        paused = PausedLaunch(engine)
        start = asyncio.create_task(engine.start(spec()))
        await paused.reached.wait()
        await engine.close()
        with pytest.raises(StartFailed):
            await start
        assert world.remains() == set()
