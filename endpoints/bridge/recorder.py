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
from twisted.logger import Logger

from endpoints.bridge.local_ros import CloudLink, LocalRos
from endpoints.data.frames import Message
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.topics import SubscriberInterface
from rce.errors import InvalidRequest, Unavailable, disk_full
from rce.net.outbox import Owner
from rce.protocol.messages import Qos
from rce.protocol.names import parse_type

QOS = Qos(depth=1000)
RETRY_INTERVAL = 1.0  # seconds after which a disk that had no room is tried again

log = Logger()


class Recording:
    """A recording, from `begin` to `end`.

    Attributes:
        path: Directory of the bag.
        messages: Number of messages in it.
        lost: Number of messages that could not be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.messages = self.lost = 0
        self._reason = ""  # why messages were lost
        self._next_try = 0.0  # monotonic time until which nothing is written
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
        """Write a message with the present time; count it as lost while the disk does not take it.

        A bag collects messages and writes them together. Those that could not be written stay there until the next try,
        so that messages in between must not be added to them.
        """
        if time.monotonic() < self._next_try:
            self.lost += 1
            return
        self.messages += 1
        try:
            self._writer.write(connection, time.time_ns(), payload)
        except OSError as error:
            if not self._reason:
                log.error("{path} cannot be written: {error}", path=str(self.path), error=str(error))
            self._reason = str(disk_full(error) or error)
            self._next_try = time.monotonic() + RETRY_INTERVAL

    def summary(self) -> str:
        """Return a sentence about what was recorded."""
        missing = f"; {self.lost} are missing: {self._reason}" if self.lost else ""
        return f"recorded {self.messages} messages into {self.path}{missing}"

    def end(self) -> None:
        """End the recording and close its file.

        Raises:
            Unavailable: The last messages cannot be written.
        """
        for interface in self._interfaces:
            self._local.remove_interface(interface)
        self._interfaces.clear()
        try:
            self._writer.close()
        except OSError as error:
            raise disk_full(error) or Unavailable(f"{self.path} cannot be completed: {error}") from None


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
