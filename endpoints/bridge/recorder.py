"""Recordings of topics of the robot's ROS, as ROS 2 bags (MCAP)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from endpoints.bridge.ends import CloudEnd, LocalRos
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.topics import SubscriberInterface
from endpoints.frames import Message
from rce.errors import InvalidRequest
from rce.messages import Qos
from rce.names import parse_type

QOS = Qos(depth=1000)


class Recording:
    """One recording, from `begin` to `end`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.messages = 0
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._near: list[RosInterface] = []
        self._local: LocalRos

    @classmethod
    async def begin(cls, local: LocalRos, topics: Mapping[str, str], directory: Path) -> Recording:
        """Record into a fresh directory in `directory`. InvalidRequest if that cannot be written, UnknownType."""
        path = directory / time.strftime("%Y%m%d-%H%M%S")
        try:
            recording = await asyncio.to_thread(cls._open, path)
        except OSError as error:
            raise InvalidRequest(f"{path}: {error}") from None
        recording._local = local
        store = get_typestore(Stores.ROS2_KILTED)
        for topic, type_name in topics.items():
            name = parse_type(type_name).msg
            if name not in store.fielddefs:
                _learn(store, local.describe(type_name))
            track = _Track(recording, recording._writer.add_connection(topic, name, typestore=store))
            recording._near.append(await local.interface(SubscriberInterface, type_name, topic, track, QOS))
        return recording

    @classmethod
    def _open(cls, path: Path) -> Recording:
        path.parent.mkdir(parents=True, exist_ok=True)
        recording = cls(path)
        recording._writer.open()
        return recording

    def write(self, connection: Connection, payload: bytes) -> None:
        self.messages += 1
        self._writer.write(connection, time.time_ns(), payload)

    def end(self) -> None:
        for interface in self._near:
            self._local.remove(interface)
        self._near.clear()
        self._writer.close()


class _Track(CloudEnd):
    """One topic."""

    def __init__(self, recording: Recording, connection: Connection) -> None:
        super().__init__()
        self._recording = recording
        self._connection = connection

    def send(self, message: Message, keep: int | None) -> int:
        self._recording.write(self._connection, bytes(message.payload))
        return 0


def _learn(store: Typestore, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(text, name))
