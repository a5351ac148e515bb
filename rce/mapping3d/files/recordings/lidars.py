"""ROS 1 and ROS 2 bags with clouds of a lidar."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rce.errors import InvalidRequest
from rce.mapping.clouds import Sweep, cloud_topic, decode
from rce.mapping.files.recordings.bags import opened_bag


class LidarBag:
    """Sweeps of one topic of a bag.

    Attributes:
        name: Name of the bag.
        frames: Number of sweeps.
        topic: Topic of the clouds.
    """

    def __init__(self, path: Path, topic: str = "") -> None:
        """Open a bag and choose its topic.

        Args:
            path: The file or directory.
            topic: Topic of the clouds; empty if there is only one.

        Raises:
            InvalidRequest: The bag cannot be read, or has no such topic, or several and none was chosen.
        """
        self.name = path.name
        self._path = path
        with opened_bag(path) as reader:
            self.topic = cloud_topic(reader, self.name, topic)
            self.frames = sum(each.msgcount for each in reader.connections if each.topic == self.topic)

    def __iter__(self) -> Iterator[Sweep]:
        """Yield the sweeps in order of time.

        Raises:
            InvalidRequest: The bag is damaged, or a cloud contradicts itself.
        """
        with opened_bag(self._path) as reader:
            chosen = [each for each in reader.connections if each.topic == self.topic]
            for number, (connection, received, data) in enumerate(reader.messages(chosen), 1):
                message: Any = reader.deserialize(data, connection.msgtype)
                try:
                    yield decode(message, received)
                except InvalidRequest as error:
                    raise InvalidRequest(
                        f"{self.name}, cloud {number} of {self.topic}: {error}", field="path"
                    ) from None
