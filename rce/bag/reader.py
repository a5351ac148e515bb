"""Reader of recordings, also of those whose process was killed."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

from mcap.exceptions import InvalidMagic, McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from msgspec import Struct, field

from rce.bag.writer import METADATA
from rce.errors import InvalidRequest

CUT_OFF = (McapError, EOFError, struct.error, ValueError)  # raised for a file that ends within a record


class Recorded(NamedTuple):
    """A message: its topic and type (`pkg/msg/Name`), the time of its arrival in ns since 1970, and its CDR."""

    topic: str
    type: str
    time: int
    cdr: bytes


class Summary(Struct):
    """Contents of a recording.

    Attributes:
        size: Bytes of the file.
        complete: The file has an end; otherwise its process was killed.
        start: Time of the first message in ns since 1970.
        end: Time of the last one.
        types: Types by topic.
        counts: Numbers of messages by topic.
        dropped: Numbers of messages that were dropped, by topic.
    """

    size: int
    complete: bool = True
    start: int = 0
    end: int = 0
    types: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Seconds from the first message to the last."""
        return (self.end - self.start) / 1e9


def summarize(path: Path) -> Summary:
    """Return what is in a recording, from the statistics at its end; one without an end is read whole.

    Raises:
        InvalidRequest: It cannot be read, or is no MCAP file.
    """
    return _from_statistics(path) or _from_messages(path)


def _from_statistics(path: Path) -> Summary | None:
    with _open(path) as file:
        try:
            reader = make_reader(file)
            found = reader.get_summary()
            if found is None or found.statistics is None:
                return None
            statistics = found.statistics
            summary = Summary(_size(path), True, statistics.message_start_time, statistics.message_end_time)
            for id, count in statistics.channel_message_counts.items():
                channel = _checked(found.channels[id], path)
                summary.types[channel.topic] = found.schemas[channel.schema_id].name
                summary.counts[channel.topic] = summary.counts.get(channel.topic, 0) + count
            for record in reader.iter_metadata():
                if record.name == METADATA:
                    summary.dropped = _dropped(record)
        except (*CUT_OFF, KeyError):
            return None
    return summary


def _from_messages(path: Path) -> Summary:
    summary = Summary(_size(path))
    for each in read(path, summary):
        summary.types[each.topic] = each.type
        summary.counts[each.topic] = summary.counts.get(each.topic, 0) + 1
        summary.start = min(summary.start or each.time, each.time)
        summary.end = max(summary.end, each.time)
    return summary


def read(path: Path, summary: Summary | None = None) -> Iterator[Recorded]:
    """Yield the messages of a recording as they are in the file; of one that was cut off, all that are whole.

    Args:
        path: The file.
        summary: Takes whether the file is complete, and what was dropped.

    Raises:
        InvalidRequest: It cannot be read, or is no MCAP file, or its messages are not CDR.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with _open(path) as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = _checked(record, path)
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    yield Recorded(channel.topic, schemas[channel.schema_id].name, record.log_time, record.data)
                elif isinstance(record, Metadata) and record.name == METADATA and summary is not None:
                    summary.dropped = _dropped(record)
        except CUT_OFF as error:
            if isinstance(error, InvalidMagic) or file.tell() < len(MCAP0_MAGIC):
                raise InvalidRequest(f"{path} is no MCAP file") from None
            if summary is not None:
                summary.complete = False


def read_since(path: Path, time: int) -> Iterator[Recorded]:
    """Yield the messages of a recording from a time (ns since 1970) on; by its index, if it has an end.

    Raises:
        InvalidRequest: As `read`.
    """
    if not time or _from_statistics(path) is None:
        yield from (each for each in read(path) if each.time >= time)
        return
    with _open(path) as file:
        for schema, channel, message in make_reader(file).iter_messages(starting_at=time):
            yield Recorded(channel.topic, schema.name if schema else "", message.log_time, message.data)


def _dropped(record: Metadata) -> dict[str, int]:
    return {key.partition(" ")[2]: int(count) for key, count in record.metadata.items()}


def _checked(channel: Channel, path: Path) -> Channel:
    if channel.message_encoding != "cdr":
        raise InvalidRequest(f"{path}: messages of {channel.topic} are {channel.message_encoding}, not cdr of ROS 2")
    return channel


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise InvalidRequest(f"cannot read {path}: {error.strerror}") from None


def _open(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except OSError as error:
        raise InvalidRequest(f"cannot read {path}: {error.strerror}") from None
