"""Tests of the crew: distribution of units, lost workers, and failures."""

from __future__ import annotations

import asyncio

import pytest

from rce.errors import Died, InvalidRequest, LimitExceeded, NoCapacity, RceError, Unavailable
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.crew import MAX_ATTEMPTS, MAX_LOSSES, Crew, RemoteWorker
from rce.mapping.parallel.scan_arrays import ScanArrays, pack_scans
from rce.mapping.parallel.states import PartMap
from rce.mapping.parallel.units import FindOverlaps, KeepPart, MapPart, MapSeed, Unit
from tests.support.mapping_crew import LocalCrew, LocalWorker, dies

SETTINGS = MapperSettings()


@pytest.fixture
def scans(simulation: Simulation) -> ScanArrays:
    return pack_scans(simulation.records[:20])


async def at_once(seconds: float) -> None:
    """Pause without waiting."""
    await asyncio.sleep(0)


def kinds(worker: LocalWorker) -> list[type]:
    return [type(unit.work) for unit in worker.units]


async def test_units_are_executed_and_counted(scans: ScanArrays) -> None:
    local, reported = LocalCrew(), []
    async with Crew(local.hire, 2, reported.append) as crew:
        states = await asyncio.gather(*(crew.run(MapPart(part, scans, SETTINGS)) for part in range(4)))
    assert [len(PartMap.unpack(state or b"").history) for state in states] == [20] * 4
    assert reported[-1] == 80
    assert [record.kind for record in crew.records] == ["map_part"] * 4
    assert {record.member for record in crew.records} == {0, 1}
    assert all(record.sent > 20_000 and record.received > 1000 for record in crew.records)
    assert all(worker.closed for worker in local.workers)


async def test_worker_gets_the_parts_that_it_lacks_once(scans: ScanArrays) -> None:
    local = LocalCrew({0: lambda unit: Died("killed") if isinstance(unit.work, FindOverlaps) else None})
    async with Crew(local.hire, 1, pause=at_once) as crew:
        for part in range(2):
            await crew.run(MapPart(part, scans, SETTINGS))
        await crew.run(FindOverlaps(0, 1))
        await crew.run(FindOverlaps(1, 0))
    first, second = local.workers
    assert kinds(first) == [MapPart, MapPart, FindOverlaps]
    assert kinds(second) == [KeepPart, KeepPart, FindOverlaps, FindOverlaps]
    assert crew.lost == 1
    numbers = [unit.number for unit in second.units]
    assert numbers == sorted(set(numbers)), "a worker takes a number that is not higher for a repetition"


async def test_lost_worker_costs_its_unit_only(scans: ScanArrays) -> None:
    local = LocalCrew({0: dies})
    async with Crew(local.hire, 2, pause=at_once) as crew:
        await asyncio.gather(*(crew.run(MapPart(part, scans, SETTINGS)) for part in range(6)))
    assert sum(len(worker.units) for worker in local.workers) == 7
    assert crew.lost == 1


async def test_unit_that_kills_its_workers_fails(scans: ScanArrays) -> None:
    def fault(unit: Unit) -> RceError | None:
        return Died("out of memory") if isinstance(unit.work, MapPart) and unit.work.part == 1 else None

    local = LocalCrew(dict.fromkeys(range(20), fault))
    async with Crew(local.hire, 1, pause=at_once) as crew:
        with pytest.raises(Died, match="out of memory"):
            await crew.run(MapPart(1, scans, SETTINGS))
        assert await crew.run(MapPart(0, scans, SETTINGS)), "the crew goes on"
    assert crew.lost == MAX_ATTEMPTS


async def test_impossible_work_fails_without_loss() -> None:
    local = LocalCrew()
    async with Crew(local.hire, 1) as crew:
        crew._parts = {0: b"damaged", 1: b"damaged"}
        with pytest.raises(InvalidRequest):
            await crew.run(FindOverlaps(0, 1))
    assert (crew.lost, len(local.workers)) == (0, 1)


async def test_unit_that_is_not_needed_any_more_is_skipped() -> None:
    local = LocalCrew()
    async with Crew(local.hire, 1) as crew:
        assert await crew.run(FindOverlaps(0, 1), lambda: False) is None
    assert not local.workers[0].units


async def test_crew_goes_on_with_the_workers_that_it_gets(scans: ScanArrays) -> None:
    local = LocalCrew()

    async def hire(member: int) -> RemoteWorker:
        if member:
            raise LimitExceeded("one environment is your limit", limit=1)
        return await local.hire(member)

    async with Crew(hire, 3) as crew:
        await asyncio.gather(*(crew.run(MapPart(part, scans, SETTINGS)) for part in range(3)))
    assert {record.member for record in crew.records} == {0}


@pytest.mark.parametrize(("error", "hires"), [(InvalidRequest("no such image"), 1), (NoCapacity("full"), MAX_LOSSES)])
async def test_crew_without_workers_fails(error: RceError, hires: int) -> None:
    asked = 0

    async def hire(member: int) -> RemoteWorker:
        nonlocal asked
        asked += 1
        raise error

    async with Crew(hire, 1, pause=at_once) as crew:
        with pytest.raises(type(error), match=str(error)):
            await crew.run(FindOverlaps(0, 1))
        with pytest.raises(type(error)):
            await crew.run(FindOverlaps(1, 0))
    assert asked == hires


async def test_workers_are_dismissed_with_the_crew(scans: ScanArrays) -> None:
    local = LocalCrew()
    async with Crew(local.hire, 1) as crew:
        running = asyncio.create_task(crew.run(MapPart(0, scans, SETTINGS)))
        await local.hired.wait()
        await local.workers[0].at_work.wait()
    assert local.workers[0].closed
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_bug_fails_the_unit_instead_of_leaving_it_open() -> None:
    local = LocalCrew({0: broken})
    async with Crew(local.hire, 1) as crew:
        with pytest.raises(ZeroDivisionError):
            await crew.run(MapSeed(pack_scans([]), SETTINGS))


def broken(unit: Unit) -> RceError | None:
    raise ZeroDivisionError


async def test_worker_that_cannot_be_dismissed_is_an_error(scans: ScanArrays, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its environment may be left on the platform."""

    async def close(worker: LocalWorker) -> None:
        raise Unavailable("no connection")

    async def one_unit(failure: Exception | None) -> None:
        async with Crew(LocalCrew().hire, 1) as crew:
            await crew.run(MapPart(0, scans, SETTINGS))
            if failure is not None:
                raise failure

    monkeypatch.setattr(LocalWorker, "close", close)
    with pytest.raises(Unavailable):
        await one_unit(None)
    with pytest.raises(ZeroDivisionError):
        await one_unit(ZeroDivisionError())


async def test_unit_for_which_nobody_waits_any_more_is_not_executed(scans: ScanArrays) -> None:
    local = LocalCrew()
    async with Crew(local.hire, 1) as crew:
        first = asyncio.create_task(crew.run(MapPart(0, scans, SETTINGS)))
        await asyncio.sleep(0)
        second = asyncio.create_task(crew.run(MapPart(1, scans, SETTINGS)))
        await asyncio.sleep(0)
        second.cancel()
        await first
        await crew.run(MapPart(2, scans, SETTINGS))
    assert [unit.work.part for unit in local.workers[0].units if isinstance(unit.work, MapPart)] == [0, 2]


async def test_worker_that_fails_while_the_crew_is_dismissed_is_not_hired_again() -> None:
    asked = 0
    hiring = asyncio.Event()

    async def hire(member: int) -> RemoteWorker:
        nonlocal asked
        asked += 1
        hiring.set()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            raise Unavailable("its environment may be left") from None
        raise AssertionError

    async def dismiss() -> None:
        async with Crew(hire, 1, pause=at_once):
            await hiring.wait()

    with pytest.raises(Unavailable, match="may be left"):
        await asyncio.wait_for(dismiss(), 10)
    assert asked == 1
