"""Actions of a bridge: recordings, maps of them, and offloading."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.bridge.actions import Actions
from endpoints.bridge.config import BridgeConfig, BuildMap, EndRecording, Record, StartOffloading, StopOffloading
from endpoints.bridge.map_builder import MapBuilder
from endpoints.bridge.offloading import Offloading
from rce.errors import InvalidRequest, NotFound, UnknownType
from tests.support.endpoints.fake_local_ros import FakeLocalRos

MESSAGE = b"\0\1\0\0\2\0\0\0a\0"


class FakeOffloading:
    def __init__(self) -> None:
        self.on = False

    async def start(self) -> None:
        self.on = True

    async def stop(self) -> None:
        self.on = False


@pytest.fixture
def maps(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Recordings of which maps were built."""
    built: list[Path] = []

    async def build(_: MapBuilder, recording: Path, action: BuildMap) -> str:
        built.append(recording)
        return f"a map is published on {action.topic}"

    monkeypatch.setattr(MapBuilder, "build", build)
    return built


@pytest.fixture
async def actions(
    local: FakeLocalRos, make_config: Callable[..., BridgeConfig], maps: list[Path]
) -> AsyncIterator[Actions]:
    made = Actions(make_config(), local)
    made.offloading = cast(Offloading, FakeOffloading())
    yield made
    await made.close()


def record(directory: Path) -> Record:
    return Record({"/said": "std_msgs/String"}, directory)


def recorded(directory: Path) -> Path:
    """Return the only recording in a directory."""
    (path,) = directory.iterdir()
    return path


async def test_recording_has_all_messages_until_its_end(actions: Actions, local: FakeLocalRos, tmp_path: Path) -> None:
    bags = tmp_path / "bags"
    assert await actions.perform(record(bags)) == f"recording into {recorded(bags)}"
    for _ in range(3):
        local.interfaces["/said"].send(MESSAGE)
    assert await actions.perform(EndRecording()) == f"recorded 3 messages into {recorded(bags)}"
    assert local.interfaces == {}
    assert {path.suffix for path in recorded(bags).iterdir()} == {".mcap", ".yaml"}


async def test_one_recording_runs_at_a_time(actions: Actions, tmp_path: Path) -> None:
    begun, refused = await asyncio.gather(
        *(actions.perform(record(tmp_path / name)) for name in ("one", "two")), return_exceptions=True
    )
    assert begun == f"recording into {recorded(tmp_path / 'one')}"
    assert isinstance(refused, InvalidRequest)
    assert not (tmp_path / "two").exists()
    with pytest.raises(InvalidRequest, match="end it first"):
        await actions.perform(record(tmp_path / "three"))
    await actions.perform(EndRecording())
    await actions.perform(record(tmp_path / "four"))


async def test_recording_that_cannot_begin_does_not_block_the_next(
    actions: Actions, local: FakeLocalRos, tmp_path: Path
) -> None:
    local.refusals["/said"] = UnknownType("no such type")
    with pytest.raises(UnknownType):
        await actions.perform(record(tmp_path / "one"))
    await actions.perform(record(tmp_path / "two"))


async def test_only_a_recording_in_progress_can_end(actions: Actions, tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no recording is in progress"):
        await actions.perform(EndRecording())
    await actions.perform(record(tmp_path / "bags"))
    await actions.perform(EndRecording())
    with pytest.raises(NotFound):
        await actions.perform(EndRecording())


async def test_map_is_built_of_newest_recording(actions: Actions, maps: list[Path], tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="make one first"):
        await actions.perform(BuildMap())
    await actions.perform(record(tmp_path / "old"))
    await actions.perform(EndRecording())
    assert await actions.perform(BuildMap("/map")) == "a map is published on /map"
    await actions.perform(record(tmp_path / "new"))
    await actions.perform(BuildMap())
    assert maps == [recorded(tmp_path / "old"), recorded(tmp_path / "new")]
    with pytest.raises(NotFound):
        await actions.perform(EndRecording())  # building the map has ended it


async def test_offloading_is_switched_on_and_off(actions: Actions) -> None:
    fake = cast(FakeOffloading, actions.offloading)
    assert await actions.perform(StartOffloading()) == "offloading to environment sky"
    assert fake.on
    assert await actions.perform(StopOffloading()) == "offloading has stopped"
    assert not fake.on


async def test_close_ends_recording_and_offloading(actions: Actions, local: FakeLocalRos, tmp_path: Path) -> None:
    await actions.perform(StartOffloading())
    await actions.perform(record(tmp_path / "bags"))
    await actions.close()
    assert local.interfaces == {}
    assert not cast(FakeOffloading, actions.offloading).on
    assert (recorded(tmp_path / "bags") / "metadata.yaml").exists(), "its file is complete"
