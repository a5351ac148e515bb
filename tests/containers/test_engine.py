"""Behaviour that all engines have in common, beyond the contract suite: reports during recovery, strays and limits."""

import asyncio
from types import SimpleNamespace

import pytest

from containers.engine import LIMIT_REPORT_INTERVAL, RunningEnvironment
from containers.fake import FakeEngine, FakeMachine, SlowEngine, UnavailableEngine
from rce.errors import NotFound, StartFailed, Unavailable
from tests.support.containers.engine_contract import Endings, spec


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


@pytest.fixture
async def stuck(monkeypatch: pytest.MonkeyPatch) -> UnavailableEngine:
    """Engine whose removal of ann/map has failed, and is tried again whenever the loop is free."""
    monkeypatch.setattr("containers.engine.REMOVE_AGAIN", 0)
    engine = UnavailableEngine(1, (), Endings())
    await engine.open()
    await engine.start(spec())
    engine.unavailable = True
    with pytest.raises(Unavailable):
        await engine.stop("ann/map")
    return engine


async def turns() -> None:
    """Let the loop run long enough for several attempts."""
    for _ in range(50):
        await asyncio.sleep(0)


async def test_removal_that_failed_is_tried_again(stuck: UnavailableEngine) -> None:
    """As of processes that take long to end on a busy machine: their directory would stay until the next task set."""
    await turns()
    assert list(stuck.running()) == ["ann/map"], "it is still there"
    stuck.unavailable = False
    await turns()
    assert not stuck.running()
    assert not stuck.machine.running
    await stuck.close()


async def test_next_life_is_not_taken_for_the_remains_of_the_one_before(stuck: UnavailableEngine) -> None:
    stuck.unavailable = False
    await stuck.start(spec(run=2))
    await turns()
    assert {name: each.run for name, each in stuck.running().items()} == {"ann/map": spec(run=2).run}
    await stuck.close()


async def test_close_leaves_failed_removals_to_the_next_task_set() -> None:
    engine = UnavailableEngine(1, (), Endings())
    await engine.open()
    await engine.start(spec())
    engine.unavailable = True
    with pytest.raises(Unavailable):
        await engine.stop("ann/map")
    await asyncio.wait_for(engine.close(), 60)


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


async def test_limit_is_reported_again_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    engine, reports = FakeEngine(1, (), Endings()), list[str]()
    engine.on_limit = lambda name, run, reason: reports.append(reason)
    await engine.open()
    await engine.start(spec())
    now = asyncio.get_running_loop().time()
    for passed in (0.0, LIMIT_REPORT_INTERVAL - 1, LIMIT_REPORT_INTERVAL, LIMIT_REPORT_INTERVAL + 1):
        with monkeypatch.context() as patch:
            patch.setattr(asyncio, "get_running_loop", lambda at=now + passed: SimpleNamespace(time=lambda: at))
            engine.report_limit("ann/map", spec().run, f"after {passed:g} s")
    assert reports == ["after 0 s", "after 10 s"]
    await engine.close()


async def test_close_waits_for_the_clean_up_of_a_cancelled_start() -> None:
    engine = SlowEngine(1, (), Endings())
    await engine.open()
    start = asyncio.create_task(engine.start(spec()))
    await asyncio.sleep(0)
    await engine.close()
    assert engine.machine.leftovers == {}
    with pytest.raises(StartFailed, match="stopped while it started"):
        await start


async def test_end_is_reported_although_the_remains_cannot_be_removed() -> None:
    endings = Endings()
    engine = UnavailableEngine(1, (), endings)
    await engine.open()
    await engine.start(spec())
    engine.unavailable = True
    engine.machine.end("ann/map", 3)
    assert (await endings.next()).status == 3
    assert engine.running() == {}
    assert engine.machine.leftovers


async def test_failed_stop_keeps_the_environment_and_its_slots() -> None:
    engine = UnavailableEngine(1, (), Endings())
    await engine.open()
    await engine.start(spec())
    engine.unavailable = True
    with pytest.raises(Unavailable):
        await engine.stop("ann/map")
    assert list(engine.running()) == ["ann/map"]


async def test_engine_without_a_master_fetches_no_packages() -> None:
    with pytest.raises(NotFound, match="no Master to ask"):
        await FakeEngine(1, (), Endings()).request_ticket("0" * 64)
