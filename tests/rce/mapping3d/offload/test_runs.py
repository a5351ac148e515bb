from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.files.trajectories import read_trajectory
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.offload import runs
from rce.mapping3d.offload.runs import map_recordings
from tests.support.cloud_mapper import CloudMapper
from tests.support.rgbd import CLEAN, simulated

ACCESS = SimpleNamespace(url="http://127.0.0.1:1/", user="ann", password="x", key=None)


class Platform(CloudMapper):
    """A robot, and its environment with a mapper, at an engine that has no images."""

    def __init__(self) -> None:
        super().__init__("/robot_1")
        self.actions: list[str] = []
        self._options: dict[str, Any] = {}

    def environment(self, tag: str, **options: Any) -> Self:
        self._options = options
        return self

    async def __aenter__(self) -> Self:
        if "image" in self._options:
            raise InvalidRequest("this engine has no images")
        return self

    async def __aexit__(self, *_: object) -> None:
        self.actions.append("left")

    async def set_parameter(self, name: str, value: Any) -> None:
        self.actions.append(f"{name}={value}")

    async def add_node(self, tag: str, package: str, executable: str) -> None:
        self.actions.append(f"{package} {executable}")

    async def destroy(self) -> None:
        self.actions.append("destroyed")


@pytest.fixture
def platform(monkeypatch: pytest.MonkeyPatch) -> Platform:
    found = Platform()
    monkeypatch.setattr(runs, "Robot", lambda *_, **__: found)
    return found


@pytest.mark.slow
async def test_recording_is_tracked_here_and_mapped_there(platform: Platform, tmp_path: Path) -> None:
    recording = simulated(0.4, 2.0, CLEAN)
    counts: list[int] = []
    maps, figures = await map_recordings(ACCESS, [recording], tmp_path / "out", counts.append)
    assert counts == list(range(1, 13))
    assert maps == [(tmp_path / "out", [0])]
    assert (figures.frames, figures.lost, figures.key_frames) == (12, 0, platform.received)
    assert figures.sent > 0
    assert platform.actions == ["robots=['robot_1']", "rce_mapping3d mapper", "destroyed", "left"]
    poses = [pose for _, pose in read_trajectory(tmp_path / "out" / "trajectory.txt")]
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-6)
    assert absolute_error(poses, [pose for _, pose in recording.way]) < 0.01
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"trajectory.txt", "cloud.ply", "mesh.ply", "map.bt", "map.pgm", "map.yaml", "view.png"}
    platform.shared.close()


async def test_recording_without_depth_is_refused(platform: Platform, tmp_path: Path) -> None:
    class Blind:
        name, camera, frames = "dark", simulated().camera, 3

        def __iter__(self):  # type: ignore[no-untyped-def]
            for stamp in range(3):
                yield RgbdFrame(stamp, np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32))

    with pytest.raises(InvalidRequest, match="dark has no frame with enough depth"):
        await map_recordings(ACCESS, [Blind()], tmp_path / "out")
    assert platform.actions[-2:] == ["destroyed", "left"]
    platform.shared.close()
