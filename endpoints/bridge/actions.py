"""What other nodes of the robot may ask of the bridge, carried out: offloading, recordings, maps of them."""

from __future__ import annotations

from pathlib import Path

from endpoints.bridge.bridge import Offloading
from endpoints.bridge.config import (
    Action,
    BridgeConfig,
    BuildMap,
    EndRecording,
    Record,
    StartOffloading,
    StopOffloading,
)
from endpoints.bridge.ends import LocalRos
from endpoints.bridge.mapping import MapMaker
from endpoints.bridge.recorder import Recording
from rce.errors import InvalidRequest, NotFound


class Actions:
    """One recording runs at a time, and the newest is the one of which a map is made."""

    def __init__(self, config: BridgeConfig, local: LocalRos) -> None:
        self.offloading = Offloading(config, local)
        self._tag = config.environment.tag
        self._local = local
        self._maps = MapMaker(config, local)
        self._recording: Recording | None = None
        self._recorded: Path | None = None

    async def perform(self, action: Action) -> str:
        """Returns a sentence about what was done. Raises why it was not."""
        match action:
            case StartOffloading():
                await self.offloading.start()
                return f"offloading to {self._tag}"
            case StopOffloading():
                await self.offloading.stop()
                return "offloading is off"
            case Record(topics, directory):
                if self._recording is not None:
                    raise InvalidRequest(f"a recording runs already: {self._recording.path}")
                self._recording = await Recording.begin(self._local, topics, directory)
                return f"recording into {self._recording.path}"
            case EndRecording():
                return self._end_recording()
            case BuildMap():
                if self._recording is not None:
                    self._end_recording()
                if self._recorded is None:
                    raise NotFound("nothing has been recorded yet")
                return await self._maps.make(self._recorded, action)
        raise AssertionError("every action is one of these")

    def _end_recording(self) -> str:
        if self._recording is None:
            raise NotFound("no recording runs")
        ended, self._recording = self._recording, None
        ended.end()
        self._recorded = ended.path
        return f"{ended.messages} messages recorded in {ended.path}"

    async def close(self) -> None:
        if self._recording is not None:
            self._recording.end()
        await self.offloading.stop()
