"""Recordings of topics of the robot's ROS, as ROS 2 bags (MCAP)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from endpoints.bridge.local_ros import CloudLink, LocalRos
from endpoints.data.frames import Message
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.topics import SubscriberInterface
from rce.errors import InvalidRequest
from rce.net.outbox import Owner
from rce.protocol.messages import Qos
from rce.protocol.names import parse_type

QOS = Qos(depth=1000)


class Recording:
    """A recording, from `begin` to `end`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.messages = 0
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._interfaces: list[RosInterface] = []
        self._local: LocalRos

    @classmethod
    async def begin(cls, local: LocalRos, topics: Mapping[str, str], directory: Path) -> Recording:
        """Begin to record into a new directory in `directory`.

        Raises:
            InvalidRequest: The directory cannot be written, or a recording began within the same second.
            UnknownType: The type of a topic is not installed.
        """
        path = directory / time.strftime("%Y%m%d-%H%M%S")
        try:
            recording = await asyncio.to_thread(cls._open, path)
        except (OSError, WriterError) as error:  # the latter if another recording began within the same second
            raise InvalidRequest(f"cannot record into {path}: {error}") from None
        recording._local = local
        try:
            await recording._subscribe(topics)
        except BaseException:
            recording.end()
            raise
        return recording

    @classmethod
    def _open(cls, path: Path) -> Recording:
        path.parent.mkdir(parents=True, exist_ok=True)
        recording = cls(path)
        recording._writer.open()
        return recording

    async def _subscribe(self, topics: Mapping[str, str]) -> None:
        store = get_typestore(Stores.ROS2_KILTED)
        for topic, type_name in topics.items():
            name = parse_type(type_name).msg
            if name not in store.fielddefs:
                _register(store, self._local.describe(type_name))
            recorder = _TopicRecorder(self, self._writer.add_connection(topic, name, typestore=store))
            self._interfaces.append(
                await self._local.add_interface(SubscriberInterface, type_name, topic, recorder, QOS)
            )

    def write(self, connection: Connection, payload: bytes) -> None:
        """Write a message with the present time."""
        self.messages += 1
        self._writer.write(connection, time.time_ns(), payload)

    def end(self) -> None:
        """End the recording and close its file."""
        for interface in self._interfaces:
            self._local.remove_interface(interface)
        self._interfaces.clear()
        self._writer.close()


class _TopicRecorder(CloudLink):
    """Link that writes the messages of one topic."""

    def __init__(self, recording: Recording, connection: Connection) -> None:
        super().__init__()
        self._recording = recording
        self._connection = connection

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Write a message."""
        self._recording.write(self._connection, bytes(message.payload))
        return 0


def _register(store: Typestore, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(text, name))
