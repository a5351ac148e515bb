"""Random commands, repeated until they are certain to be executed."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest

from rce.api.map_jobs import Upload
from rce.bench.chaos import workload
from rce.bench.chaos.history import History
from rce.bench.chaos.model import Model, Step
from rce.bench.chaos.violations import Violation
from rce.bench.chaos.workload import RobotWorker, UploadWorker, Worker, recording
from rce.client import Robot
from rce.errors import (
    AlreadyExists,
    DiskFull,
    InvalidRequest,
    LimitExceeded,
    NoCapacity,
    NotFound,
    RceError,
    Unavailable,
)
from rce.mapping.files.recordings import open_recording

ADD, REMOVE = Step("add", ("environment", "e")), Step("remove", ("environment", "e"))


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workload, "RETRY_INTERVAL", 0)


class Scripted(Worker):
    """Worker whose attempts end with the given errors, and then with success."""

    def __init__(self, *errors: RceError) -> None:
        super().__init__("r0", Model(), History())
        self._errors = list(errors)

    async def execute(self, step: Step) -> None:
        if self._errors:
            raise self._errors.pop(0)


@pytest.mark.parametrize(
    ("step", "errors"),
    [
        (ADD, []),
        (ADD, [Unavailable("away"), Unavailable("away")]),
        (ADD, [Unavailable("away"), AlreadyExists("e")]),
        (REMOVE, [Unavailable("away"), NotFound("e")]),
        (REMOVE, [DiskFull.at("database"), NotFound("e")]),
        (ADD, [NoCapacity("no machine takes environments at present")]),
        (ADD, [DiskFull.at("database"), LimitExceeded("disk full: room for 0 bytes")]),
    ],
)
async def test_command_is_repeated_until_it_is_certain(step: Step, errors: list[RceError]) -> None:
    worker = Scripted(*errors)
    await worker.take(step)
    assert worker._model.acknowledged == 1
    assert worker._history.entries[-1].outcome == "acknowledged"


@pytest.mark.parametrize(
    ("errors", "reason"),
    [
        ([InvalidRequest("nonsense")], "r0 add environment e: InvalidRequest: nonsense"),
        ([AlreadyExists("e")], "AlreadyExists"),
        ([DiskFull.at("database"), AlreadyExists("e")], "AlreadyExists"),
    ],
)
async def test_error_that_no_fault_explains_is_a_violation(errors: list[RceError], reason: str) -> None:
    with pytest.raises(Violation, match=reason):
        await Scripted(*errors).take(ADD)


async def test_command_that_never_succeeds_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workload, "DEADLINE", -1)
    with pytest.raises(Violation, match="fails for -1 s: away"):
        await Scripted(Unavailable("away")).take(ADD)


async def test_refusals_for_a_full_disk_are_counted_by_themselves() -> None:
    worker = Scripted(DiskFull.at("database"), Unavailable("away"))
    await worker.take(ADD)
    assert worker.refused == {"disk full": 1, "unavailable": 1}


class FakeRobot:
    """Robot whose commands succeed."""

    name = "r0"

    def __getattr__(self, name: str) -> Callable[..., object]:
        async def succeed(*arguments: object, **options: object) -> None:
            return None

        return succeed


def robot_worker(seed: int) -> RobotWorker:
    model = Model({("environment", "r0_home"), ("environment", "r1_home")})
    return RobotWorker(cast(Robot, FakeRobot()), model, History(), seed)


async def steps(worker: RobotWorker, count: int) -> list[Step]:
    taken: list[Step] = []
    while len(taken) < count:
        step = worker.choose()
        if step is not None:
            await worker.take(step)
            taken.append(step)
    return taken


async def test_seed_determines_the_commands() -> None:
    assert await steps(robot_worker(1), 300) == await steps(robot_worker(1), 300)
    assert await steps(robot_worker(1), 300) != await steps(robot_worker(2), 300)


async def test_robot_changes_only_what_is_its_own() -> None:
    worker = robot_worker(1)
    taken = await steps(worker, 2000)
    assert {each.fact[0] for each in taken} == {"environment", "node", "parameter", "interface", "connection"}
    assert {each.verb for each in taken} == {"add", "remove"}
    assert not [each for each in taken if "r1_home" in each.fact]


class FakeMaps:
    """Map service that keeps uploads."""

    def __init__(self) -> None:
        self.kept: dict[str, Upload] = {}

    def upload(self, path: Path) -> Upload:
        size = path.stat().st_size
        self.kept[path.name] = Upload(path.name, path.name, size, size, 0.0)
        return self.kept[path.name]

    def uploads(self) -> list[Upload]:
        return list(self.kept.values())

    def remove_upload(self, upload: str) -> None:
        del self.kept[upload]


async def test_uploads_agree_with_the_model(tmp_path: Path) -> None:
    maps, model = FakeMaps(), Model()
    worker = UploadWorker(maps, tmp_path, model, History(), 1)
    for _ in range(60):
        step = worker.choose()
        assert step is not None
        await worker.take(step)
    assert {fact[1] for fact in model.facts} == set(maps.kept)
    assert 0 < len(maps.kept) <= workload.MAX_UPLOADS
    assert not any(map(os.path.exists, [tmp_path / name for name in maps.kept]))
    with pytest.raises(NotFound):
        worker._remove("another")


def test_recordings_are_carmen_logs(tmp_path: Path) -> None:
    file = tmp_path / "a.log"
    file.write_text(recording(5))
    assert len(list(open_recording(file))) == 5
