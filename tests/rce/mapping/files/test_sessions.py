from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rce.errors import InvalidRequest, NotFound
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.files.sessions import Relocating, resume_session, save_session
from rce.mapping.mapper import MapperSettings
from rce.mapping.mappers import MAPPERS, AnyMapper

pytestmark = pytest.mark.slow  # maps the simulation several times

SETTINGS = MapperSettings(particles=10)


def started(name: str, simulation: Simulation, count: int) -> AnyMapper:
    mapper = MAPPERS[name](SETTINGS)
    for scan in simulation.records[:count]:
        mapper.add(scan)
    return mapper


@pytest.mark.parametrize("name", MAPPERS)
@pytest.mark.parametrize("count", [0, 1, 250])
def test_resumed_mapper_continues_exactly(simulation: Simulation, tmp_path: Path, name: str, count: int) -> None:
    mapper, path = started(name, simulation, count), tmp_path / "session.npz"
    if count:
        mapper.grid()
    save_session(mapper, path)
    resumed = resume_session(path, cores=1)
    for scan in simulation.records[count : 2 * count + 50]:
        first, second = mapper.add(scan), resumed.add(scan)
        assert first.pose == second.pose
        np.testing.assert_array_equal(first.covariance, second.covariance)
    np.testing.assert_array_equal(mapper.trajectory(), resumed.trajectory())
    np.testing.assert_array_equal(mapper.grid().cells, resumed.grid().cells)


@pytest.mark.parametrize("name", MAPPERS)
def test_moved_robot_is_localised_before_mapping_continues(simulation: Simulation, tmp_path: Path, name: str) -> None:
    whole = started(name, simulation, 700)
    save_session(whole, tmp_path / "session.npz")
    truth = whole.trajectory()
    resumed = Relocating(resume_session(tmp_path / "session.npz"))
    answers = [  # the robot continues at another place than where it had stopped
        resumed.add(dataclasses.replace(scan, stamp=scan.stamp + 1000.0, odometry=None))
        for scan in simulation.records[200:350]
    ]
    assert not resumed.lost
    taken = np.array([answer.accepted for answer in answers])
    assert taken.sum() > 80
    assert taken[np.argmax(taken) :].all()
    off = np.hypot(*(np.array([answer.pose[:2] for answer in answers]) - truth[200:350, 1:3])[taken].T)
    assert off.max() < 0.2
    assert len(resumed.trajectory()) == 700 + taken.sum()


@pytest.mark.parametrize("name", MAPPERS)
def test_session_file_is_small(simulation: Simulation, tmp_path: Path, name: str) -> None:
    path = tmp_path / "session.npz"
    save_session(started(name, simulation, 200), path)
    assert path.stat().st_size < 3_000_000


def saved(simulation: Simulation, path: Path, name: str = "graph") -> dict[str, Any]:
    save_session(started(name, simulation, 60), path)
    with np.load(path) as archive:
        return dict(archive)


@pytest.mark.parametrize("name", MAPPERS)
def test_missing_or_invalid_array_is_rejected(simulation: Simulation, tmp_path: Path, name: str) -> None:
    path = tmp_path / "session.npz"
    arrays = saved(simulation, path, name)
    for key, value in arrays.items():
        wrong: list[Any] = [None, value.astype(np.complex64) if value.dtype.kind != "U" else value[:1]]
        if value.dtype.kind == "f" and value.size:
            wrong.append(np.full_like(value, np.nan))
        for other in wrong:
            changed = {**arrays, key: other} if other is not None else {k: v for k, v in arrays.items() if k != key}
            np.savez(path, **changed)
            with pytest.raises(InvalidRequest, match="session"):
                resume_session(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("paths/0/trail/reference", 10_000),
        ("paths/0/history/nodes", 10_000),
        ("paths/0/graph/edges/ends", -2),
        ("paths/0/graph/points/lengths", 7),
    ],
)
def test_indices_out_of_range_are_rejected(simulation: Simulation, tmp_path: Path, key: str, value: int) -> None:
    path = tmp_path / "session.npz"
    arrays = saved(simulation, path)
    if not arrays[key].size:
        arrays[key] = np.full((1, 2), value)
    np.savez(path, **{**arrays, key: np.full_like(arrays[key], value)})
    with pytest.raises(InvalidRequest, match=key):
        resume_session(path)


def test_files_of_other_formats_are_rejected(simulation: Simulation, tmp_path: Path) -> None:
    path = tmp_path / "session.npz"
    with pytest.raises(NotFound, match="no such saved session"):
        resume_session(path)
    arrays = saved(simulation, path)
    good = path.read_bytes()
    for content in (b"", b"text", good[: len(good) // 2], good[:1000] + bytes(500) + good[1500:]):
        path.write_bytes(content)
        with pytest.raises(InvalidRequest, match="session"):
            resume_session(path)
    about = arrays["about"].copy()
    about[1] = "99"
    np.savez(path, **{**arrays, "about": about})
    with pytest.raises(InvalidRequest, match="version 99; this program supports version 4"):
        resume_session(path)
    np.savez(path, about=np.array([{}], object))
    with pytest.raises(InvalidRequest, match="session"):
        resume_session(path)


def test_file_that_unpacks_to_too_much_is_rejected(
    simulation: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "session.npz"
    saved(simulation, path)
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    monkeypatch.setattr("rce.mapping.files.arrays.MAX_BYTES", size - 1)
    with pytest.raises(InvalidRequest, match="would take more"):
        resume_session(path)
