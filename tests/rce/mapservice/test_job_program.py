"""The program of one job, with stand-ins for the platform and for the mapping node."""

from __future__ import annotations

import json
import ssl
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from rce.api.map_jobs import MapOptions
from rce.errors import Died, InvalidRequest, NotFound
from rce.mapping.grid import OccupancyGrid
from rce.mapping.parallel.job import JointMap
from rce.mapping.parallel.run import Method, ParallelRun
from rce.mapping.robot import Result
from rce.mapping.scans import Scan
from rce.mapping3d.offload.runs import RunFigures
from rce.mapservice import job_program
from rce.mapservice.job_program import (
    Platform,
    Report,
    Task,
    build,
    build_3d,
    build_parallel,
    inspect,
    recordings_of,
    send,
    trust_only,
)
from rce.net.certificates import Authority
from rce.net.tls import CERTIFICATE
from tests.support.certificates import certify
from tests.support.map_service import LOG
from tests.support.rgbd import CLEAN, simulated, write_bag1

OPTIONS = MapOptions(mapper="particle", resolution=0.1, max_range=20.0)
PLATFORM = Platform("http://entry/", "ann", "rce_key")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """CARMEN log of 20 scans."""
    path = tmp_path / "a.log"
    path.write_bytes(LOG)
    return path


def test_inspection_counts_the_scans(recording: Path) -> None:
    assert inspect(Task(str(recording), OPTIONS)) == 20


@pytest.mark.parametrize("content", [b"", b"FLASER 4 1.0"], ids=["empty", "cut"])
def test_inspection_refuses_a_recording_that_cannot_be_mapped(recording: Path, content: bytes) -> None:
    recording.write_bytes(content)
    with pytest.raises(InvalidRequest) as refused:
        inspect(Task(str(recording), OPTIONS))
    assert refused.value.field == "uploads", "the client does not know the path"


class Empty:
    """Recording that announces scans and has none."""

    name, scans, duration = "a.bag", 9, None

    def __iter__(self) -> Iterator[Scan]:
        return iter(())


def test_inspection_refuses_a_recording_without_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rce.mapping.files.recordings.open_recording", lambda *_: Empty())
    with pytest.raises(InvalidRequest, match="no laser scans"):
        inspect(Task("a.bag", OPTIONS))


def test_wrong_topic_is_an_error_of_the_options(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, scan_topic: str, odometry_topic: str) -> None:
        raise NotFound(f"no topic {scan_topic} or {odometry_topic}", field="topic")

    monkeypatch.setattr("rce.mapping.files.recordings.open_recording", refuse)
    with pytest.raises(NotFound, match="no topic /front or /wheels") as refused:
        inspect(Task("a.bag", MapOptions(scan_topic="/front", odometry_topic="/wheels")))
    assert refused.value.field == "options.scan_topic"


CAMERA = MapOptions(kind="3d")


def test_frames_of_a_camera_are_counted(tmp_path: Path) -> None:
    path = write_bag1(tmp_path, list(simulated(0.2, faults=CLEAN)))
    assert inspect(Task(str(path), CAMERA)) == 6


def test_inspection_refuses_a_bag_without_depth(tmp_path: Path) -> None:
    path = write_bag1(tmp_path, [])
    with pytest.raises(InvalidRequest) as refused:
        inspect(Task(str(path), CAMERA))
    assert refused.value.field == "uploads"


async def test_recording_of_a_camera_is_mapped_in_space(
    tmp_path: Path, existing: set[str], sent: list[Report], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def mapped(robots: list[Any], name: str, recordings: list[Any], out: Path, progress: Any) -> Any:
        assert (name, out, len(robots), recordings[0].frames) == ("map_x_3", tmp_path / "out", 1, 3)
        assert existing == {"other"}
        progress(3)
        return [], RunFigures(frames=3)

    monkeypatch.setattr("rce.mapping3d.offload.runs.map_with", mapped)
    path = write_bag1(tmp_path, list(simulated(0.1, faults=CLEAN)))
    task = Task(str(path), CAMERA, str(tmp_path / "out"), "map_x_3", ["map_x_1"], PLATFORM)
    await build_3d(task, PLATFORM)
    assert [(report.stage, report.scans, report.clean) for report in sent] == [
        ("preparing", 0, False),
        ("mapping", 3, False),
        ("finishing", 3, True),
    ]


def test_reports_are_lines_of_json(capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    reports = [Report("mapping", 7, 12, {"opening": 0.5}), Report(clean=True, error=Died("x").info)]
    for report in reports:
        send(report)
    lines = capfdbinary.readouterr().out.splitlines()
    assert [msgspec.json.decode(line, type=Report) for line in lines] == reports


def test_only_the_given_certificate_is_trusted(tmp_path: Path) -> None:
    certificate = certify(tmp_path / "tls", Authority.make("platform"), ["entry"]) / CERTIFICATE
    context = trust_only(str(certificate))
    assert context is not None
    assert (context.verify_mode, context.check_hostname) == (ssl.CERT_REQUIRED, False)
    assert context.verify_flags & ssl.VERIFY_X509_PARTIAL_CHAIN, "its issuer is unknown"
    assert context.cert_store_stats()["x509"] == 1


def test_public_authorities_are_trusted_without_a_certificate() -> None:
    assert trust_only("") is None


class FakeRobot:
    """Robot on a platform that has the environments of `existing`."""

    def __init__(self, existing: set[str], url: str, **options: Any) -> None:
        self.existing, self.url, self.options = existing, url, options

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        pass

    async def destroy_environment(self, tag: str) -> None:
        if tag not in self.existing:
            raise NotFound(f"no environment {tag}")
        self.existing.remove(tag)

    def environment(self, tag: str, **options: Any) -> FakeEnvironment:
        return FakeEnvironment(self.existing, tag)


class FakeEnvironment:
    def __init__(self, existing: set[str], tag: str) -> None:
        self.existing, self.tag = existing, tag

    async def __aenter__(self) -> Self:
        self.existing.add(self.tag)
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self.existing.remove(self.tag)


class FakeMapping:
    """Mapping node that answers each scan at once, or dies."""

    failure: Exception | None = None
    parameters: dict[str, Any]

    def __init__(self, robot: FakeRobot, environment: FakeEnvironment) -> None:
        assert environment.tag in robot.existing
        assert not any(tag.startswith("map_x_") and tag != environment.tag for tag in robot.existing)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        pass

    async def prepare(self, parameters: dict[str, Any]) -> None:
        type(self).parameters = parameters

    async def drive(self, recording: Iterable[Scan], progress: Callable[[int], None]) -> None:
        if self.failure is not None:
            raise self.failure
        self.count = len(list(recording))
        progress(self.count)

    async def result(self) -> Result:
        grid = OccupancyGrid(np.zeros((2, 2), np.int8), 0.1, 0.0, 0.0)
        return Result(grid, np.zeros((self.count, 4)), self.count)


@pytest.fixture
def existing(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Environments of the platform."""
    existing = {"map_x_1", "other"}

    class Robot(FakeRobot):
        def __init__(self, url: str, **options: Any) -> None:
            super().__init__(existing, url, **options)

    monkeypatch.setattr("rce.client.Robot", Robot)
    monkeypatch.setattr("rce.mapping.robot.MappingRobot", FakeMapping)
    monkeypatch.setattr(FakeMapping, "failure", None)
    return existing


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[Report]:
    """Reports of the program."""
    sent: list[Report] = []
    monkeypatch.setattr(job_program, "send", sent.append)
    return sent


async def test_recording_is_mapped_in_an_environment_of_its_own(
    recording: Path, tmp_path: Path, existing: set[str], sent: list[Report]
) -> None:
    task = Task(str(recording), OPTIONS, str(tmp_path / "out"), "map_x_3", ["map_x_1", "map_x_2"], PLATFORM)
    await build(task, PLATFORM)
    assert existing == {"other"}, "environments of earlier attempts are removed, too"
    assert FakeMapping.parameters == {"mapper": "particle", "resolution": 0.1, "max_range": 20.0}
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "map.pgm",
        "map.png",
        "map.yaml",
        "trajectory.txt",
    ]
    assert [(report.stage, report.scans, report.clean) for report in sent] == [
        ("preparing", 0, False),
        ("mapping", 20, False),
        ("writing", 20, False),
        ("finishing", 20, True),
    ]
    assert list(sent[-1].times) == ["opening", "preparing", "mapping", "writing"]


async def test_environment_is_removed_when_the_node_dies(
    recording: Path, tmp_path: Path, existing: set[str], sent: list[Report], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FakeMapping, "failure", Died("the mapping node ended with status 1"))
    with pytest.raises(Died):
        await build(Task(str(recording), OPTIONS, str(tmp_path / "out"), "map_x_2", ["map_x_1"], PLATFORM), PLATFORM)
    assert existing == {"other"}
    assert not any(report.clean for report in sent)
    assert not (tmp_path / "out").exists()


def performed(task: Task) -> tuple[int, list[Any], str]:
    """Perform a task in a process; return its status, reports and log."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "rce.mapservice.job_program"],
        input=msgspec.json.encode(task),
        capture_output=True,
        check=False,
    )
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines()], done.stderr.decode()


def test_process_inspects_a_recording_or_reports_its_error(recording: Path) -> None:
    assert performed(Task(str(recording), OPTIONS)) == (0, [{"stage": "inspected", "total": 20, "clean": True}], "")
    status, (report,), log = performed(Task(str(recording.with_name("b.log")), OPTIONS))
    assert (status, report["stage"], report["clean"], report["error"]["code"]) == (1, "failed", True, "not_found")
    assert "no such recording" in log


@pytest.mark.parametrize(("names", "recordings"), [(["b.log", "a.log"], 2), (["metadata.yaml", "a.mcap"], 1)])
def test_several_files_are_recordings_unless_they_are_a_bag(tmp_path: Path, names: list[str], recordings: int) -> None:
    for name in names:
        (tmp_path / name).touch()
    found = recordings_of(Task(str(tmp_path), OPTIONS))
    assert found == ([tmp_path / "a.log", tmp_path / "b.log"] if recordings == 2 else [tmp_path])


async def test_several_recordings_are_mapped_by_workers(
    tmp_path: Path, existing: set[str], sent: list[Report], monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = tmp_path / "recordings"
    directory.mkdir()
    for name in ("a.log", "b.log"):
        (directory / name).write_bytes(LOG)
    grid = OccupancyGrid(np.full((4, 4), 100, np.int8), 0.1, 0.0, 0.0)
    rows = np.zeros((20, 4))

    async def mapped(robot: Any, name: str, recordings: list[Any], method: Method, progress: Any) -> ParallelRun:
        assert (name, len(recordings), method.workers, method.mapper) == ("map_x_3", 2, 2, "particle")
        assert (method.settings.resolution, method.settings.max_range) == (0.1, 20.0)
        assert existing == {"other"}, "the environments of all workers of earlier attempts are removed"
        progress(15)
        return ParallelRun([JointMap(grid, {0: rows}), JointMap(grid, {1: rows})], [], 1)

    monkeypatch.setattr("rce.mapping.parallel.run.run", mapped)
    existing |= {"map_x_1_0", "map_x_1_1"}
    task = Task(str(directory), replace(OPTIONS, parallel=2), str(tmp_path / "out"), "map_x_3", ["map_x_1"], PLATFORM)
    assert inspect(task) == 40
    await build_parallel(task, PLATFORM)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        *("map.pgm", "map.png", "map.yaml", "map_2.pgm", "map_2.png", "map_2.yaml"),
        *("trajectory_1.txt", "trajectory_2.txt"),
    ]
    assert "image: map_2.pgm" in (tmp_path / "out" / "map_2.yaml").read_text()
    assert [(report.stage, report.scans, report.total, report.clean) for report in sent] == [
        ("preparing", 0, 40, False),
        ("mapping", 15, 40, False),
        ("writing", 40, 40, False),
        ("finishing", 40, 40, True),
    ]


def test_cameras_have_one_worker(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest) as refused:
        inspect(Task(str(tmp_path), replace(CAMERA, parallel=2)))
    assert refused.value.field == "options.parallel"
