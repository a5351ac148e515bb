"""Run of a parallel mapping job on a platform."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from rce.client import Robot
from rce.errors import InvalidRequest
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.crew import Crew, RemoteWorker, UnitRecord
from rce.mapping.parallel.environments import EnvironmentWorker
from rce.mapping.parallel.job import JointMap, map_seeds, map_together
from rce.mapping.scans import Scan


@dataclass(frozen=True, slots=True)
class Method:
    """Method of mapping recordings.

    Attributes:
        workers: Number of workers, each in an environment of its own.
        mapper: `graph` joins recordings that overlap. `particle` maps each recording as many times as there are
            workers, with different seeds, and keeps the best map.
        settings: Settings of the mapper.
    """

    workers: int
    mapper: Literal["graph", "particle"]
    settings: MapperSettings


@dataclass(frozen=True, slots=True)
class ParallelRun:
    """Result of a job.

    Attributes:
        maps: The maps; recordings that overlap share one.
        units: Costs of the units of work.
        lost: Number of workers that were lost and replaced.
    """

    maps: list[JointMap]
    units: list[UnitRecord]
    lost: int


async def run(
    robot: Robot,
    name: str,
    recordings: Sequence[Iterable[Scan]],
    method: Method,
    on_scans: Callable[[int], None] = lambda scans: None,
) -> ParallelRun:
    """Map recordings by workers in environments, which are destroyed at the end.

    Args:
        robot: Connected robot.
        name: The environments are NAME_0, NAME_1 ...; see `environments`.
        recordings: The recordings.
        method: Number of workers, mapper and settings.
        on_scans: Called with the number of scans mapped so far.

    Raises:
        InvalidRequest: A recording has no scans, or is damaged.
        RceError: No worker can be had any more, or a unit of work has failed repeatedly.
    """
    scans = [list(recording) for recording in recordings]
    if not all(scans):
        raise InvalidRequest(f"recording {scans.index([]) + 1} has no laser scans", field="path")
    total = sum(map(len, scans))
    tags = environments(name, method.workers)

    async def hire(member: int) -> RemoteWorker:
        return await EnvironmentWorker.hire(robot, tags[member])

    def report(done: int) -> None:
        on_scans(min(done, total))  # pieces share some scans

    async with Crew(hire, method.workers, report) as crew:
        if method.mapper == "graph":
            maps = await map_together(crew, scans, method.settings, method.workers)
        else:
            maps = await map_seeds(crew, scans, method.settings, method.workers)
    return ParallelRun(maps, crew.records, crew.lost)


def environments(name: str, workers: int) -> list[str]:
    """Return the names of the environments of a job."""
    return [f"{name}_{member}" for member in range(workers)]
