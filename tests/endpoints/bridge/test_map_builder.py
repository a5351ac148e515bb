"""Maps of recordings: what the map service gets, and what is published at the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from converters.types import TypeRegistry
from endpoints.bridge import map_builder
from endpoints.bridge.config import BridgeConfig, BuildMap
from endpoints.bridge.map_builder import GRID, LATCHED, MapBuilder
from rce.api.map_jobs import File, Job, MapOptions, Upload
from rce.errors import InvalidRequest, NoCapacity, RceError
from rce.protocol.names import parse_type
from tests.support.endpoints.fake_local_ros import FakeLocalRos

YAML = "image: map.png\nresolution: 0.5\norigin: [-1.0, 2.0, 0.0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


class FakeMapService:
    """Map service whose only job ends as the test says, with a map of 3 x 2 cells."""

    def __init__(self) -> None:
        self.login: dict[str, Any] = {}
        self.uploaded: list[str] = []
        self.submitted: tuple[list[str], MapOptions, str]
        self.job = Job(
            "j", "done", "", MapOptions(), [], 0.0, scans=12, files=[File("map.yaml", 0), File("map.png", 0)]
        )

    def __call__(self, url: str, **login: Any) -> FakeMapService:
        self.login = {"url": url, **login}
        return self

    def upload(self, path: Path, progress: Callable[[int], None]) -> Upload:
        progress(1)
        self.uploaded.append(path.name)
        return Upload(f"upload of {path.name}", path.name, 0, 0, 0.0)

    def submit(self, uploads: list[str], options: MapOptions, recording: str) -> Job:
        self.submitted = uploads, options, recording
        return self.job

    def watch(self, job: str) -> Iterator[Job]:
        assert job == self.job.id
        yield msgspec.structs.replace(self.job, state="running")
        yield self.job

    def fetch(self, job: str, name: str, path: Path) -> None:
        if name == "map.yaml":
            path.write_text(YAML)
        else:
            pixels = np.array([[0, 254, 205], [254, 254, 254]], np.uint8)  # occupied, free, unknown; upper row first
            path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> FakeMapService:
    fake = FakeMapService()
    monkeypatch.setattr(map_builder, "MapServiceClient", fake)
    return fake


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "20260101-000000"
    path.mkdir()
    for name in ("metadata.yaml", "bag.mcap"):
        (path / name).touch()
    return path


@pytest.fixture
def builder(local: FakeLocalRos, make_config: Callable[..., BridgeConfig], service: FakeMapService) -> MapBuilder:
    return MapBuilder(make_config(password=None, key="k"), local)


async def test_map_is_published_latched(builder: MapBuilder, local: FakeLocalRos, recording: Path) -> None:
    assert await builder.build(recording, BuildMap("/map")) == "a map of 12 scans is published on /map"
    there = local.interfaces["/map"]
    assert (there.type_name, there.qos) == (GRID, LATCHED)
    (cdr,) = there.payloads()
    grid = msgspec.json.decode(TypeRegistry().message(parse_type(GRID)).decode(cdr).raw)
    info = grid["info"]
    assert grid["header"]["frame_id"] == "map"
    assert (info["resolution"], info["width"], info["height"]) == (0.5, 3, 2)
    assert (info["origin"]["position"]["x"], info["origin"]["position"]["y"]) == (-1.0, 2.0)
    assert grid["data"] == [0, 0, 0, 100, 0, -1], "the lowest row comes first"


async def test_all_files_of_recording_are_sent_with_options(
    builder: MapBuilder, service: FakeMapService, recording: Path
) -> None:
    await builder.build(recording, BuildMap(mapper="graph", scan="/scan", odometry="/odom"))
    assert service.login == {"url": "http://127.0.0.1:1/", "user": "testUser", "password": None, "key": "k"}
    assert service.uploaded == ["bag.mcap", "metadata.yaml"]
    uploads, options, name = service.submitted
    assert (uploads, name) == (["upload of bag.mcap", "upload of metadata.yaml"], recording.name)
    assert (options.mapper, options.scan_topic, options.odometry_topic) == ("graph", "/scan", "/odom")


async def test_files_of_map_are_kept_on_request(builder: MapBuilder, recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "maps" / "newest"
    sentence = await builder.build(recording, BuildMap(out=out))
    assert sentence.endswith(f"its files are in {out}")
    assert sorted(path.name for path in out.iterdir()) == ["map.png", "map.yaml"]


async def test_next_map_is_published_on_same_topic(builder: MapBuilder, local: FakeLocalRos, recording: Path) -> None:
    for _ in range(2):
        await builder.build(recording, BuildMap("/map"))
    assert len(local.interfaces["/map"].received) == 2
    await builder.build(recording, BuildMap("/other"))
    assert set(local.interfaces) == {"/map", "/other"}


@pytest.mark.parametrize(
    ("state", "error", "kind", "words"),
    [("failed", NoCapacity("too many jobs"), NoCapacity, "too many jobs"), ("cancelled", None, RceError, "cancelled")],
)
async def test_job_without_map_is_an_error(
    builder: MapBuilder,
    local: FakeLocalRos,
    service: FakeMapService,
    recording: Path,
    state: Any,
    error: RceError | None,
    kind: type[RceError],
    words: str,
) -> None:
    service.job = msgspec.structs.replace(service.job, state=state, error=error.info if error else None)
    with pytest.raises(kind, match=words):
        await builder.build(recording, BuildMap())
    assert local.interfaces == {}


async def test_files_that_cannot_be_read_or_written_are_named(
    builder: MapBuilder, recording: Path, tmp_path: Path
) -> None:
    with pytest.raises(InvalidRequest, match="gone"):
        await builder.build(tmp_path / "gone", BuildMap())
    (tmp_path / "file").touch()
    with pytest.raises(InvalidRequest, match="file/maps"):
        await builder.build(recording, BuildMap(out=tmp_path / "file" / "maps"))
