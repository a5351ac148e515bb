"""Actions that nodes of the robot can request from the bridge: offloading, recordings, and maps of recordings."""

from __future__ import annotations

import asyncio
from pathlib import Path

from endpoints.bridge.config import (
    Action,
    BridgeConfig,
    BuildMap,
    EndRecording,
    Record,
    StartOffloading,
    StopOffloading,
)
from endpoints.bridge.local_ros import LocalRos
from endpoints.bridge.map_builder import MapBuilder
from endpoints.bridge.offloading import Offloading
from endpoints.bridge.recorder import Recording
from rce.errors import InvalidRequest, NotFound


class Actions:
    """Executes actions. One recording runs at a time; maps are built from the newest."""

    def __init__(self, config: BridgeConfig, local: LocalRos) -> None:
        self.offloading = Offloading(config, local)
        self._tag = config.environment.tag
        self._local = local
        self._maps = MapBuilder(config, local)
        self._recording_lock = asyncio.Lock()  # held while a recording begins, so that another cannot begin meanwhile
        self._recording: Recording | None = None
        self._last_recording: Path | None = None

    async def perform(self, action: Action) -> str:
        """Execute an action; return a sentence about the result, or raise RceError with the reason of the failure."""
        match action:
            case StartOffloading():
                await self.offloading.start()
                return f"offloading to environment {self._tag}"
            case StopOffloading():
                await self.offloading.stop()
                return "offloading has stopped"
            case Record(topics, directory):
                async with self._recording_lock:
                    if self._recording is not None:
                        raise InvalidRequest(
                            f"a recording is in progress already: {self._recording.path}; end it first"
                        )
                    self._recording = await Recording.begin(self._local, topics, directory)
                    return f"recording into {self._recording.path}"
            case EndRecording():
                async with self._recording_lock:
                    return self._end_recording()
            case BuildMap():
                async with self._recording_lock:
                    if self._recording is not None:
                        self._end_recording()
                if self._last_recording is None:
                    raise NotFound("there is no recording yet: make one first")
                return await self._maps.build(self._last_recording, action)
        raise AssertionError(f"unknown action {action}")

    def _end_recording(self) -> str:
        if self._recording is None:
            raise NotFound("no recording is in progress")
        ended, self._recording = self._recording, None
        ended.end()
        self._last_recording = ended.path
        return ended.summary()

    async def close(self) -> None:
        """End the recording and stop offloading."""
        if self._recording is not None:
            self._end_recording()
        await self.offloading.stop()
