"""Fake engines: the contract of the one that behaves, and the faults of the others."""

import asyncio

import pytest

from containers.fake import DyingEngine, FailingEngine, NeverEngine, SlowEngine, UnavailableEngine
from rce.errors import StartFailed, Unavailable
from tests.support.containers.engine_contract import Endings, EngineContract, World, opened, spec
from tests.support.containers.fake_world import FakeWorld


@pytest.fixture
def world() -> World:
    return FakeWorld()


class TestFakeEngine(EngineContract):
    async def test_half_started_environment_is_removed(self, world: FakeWorld) -> None:
        world.machine.leftovers["ann/map"] = spec().run
        async with opened(world.engine(Endings())):
            assert world.remains() == set()


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


async def test_unavailable_machine_keeps_a_half_started_environment() -> None:
    engine = UnavailableEngine(1, (), Endings())
    await engine.open()
    engine.unavailable = True
    with pytest.raises(Unavailable):
        await engine.stop("ann/map")
    with pytest.raises(StartFailed):
        await engine.start(spec())
    assert engine.machine.leftovers == {"ann/map": spec().run}
    engine.unavailable = False
    await engine.stop("ann/map")
    assert engine.machine.leftovers == {}
