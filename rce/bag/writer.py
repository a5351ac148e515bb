"""Writer of recordings: MCAP with chunks that zstd compresses, in one file or in several."""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple, Protocol, cast

from mcap.writer import CompressionType, Writer

from rce import __version__
from rce.errors import InvalidRequest, RceError, disk_full

MEGABYTE = 1_000_000
CHUNK = MEGABYTE  # bytes
MAX_WAITING = 64 * MEGABYTE  # bytes of messages that wait for the disk; more are dropped
FLUSH_INTERVAL = 1.0  # seconds: what a recording loses at most if its process is killed
METADATA = "rce"  # name of the record with the numbers of dropped messages


class Limits(NamedTuple):
    """Size of a file in bytes and its duration in seconds after which the next one begins; 0 is no limit."""

    size: int = 0
    seconds: float = 0.0


NO_LIMITS = Limits()


class Output(Protocol):
    """Target of a file of a recording. Its methods may raise RceError, which ends the recording."""

    def write(self, data: bytes, /) -> int:
        """Append bytes."""

    def tell(self) -> int:
        """Return the number of bytes so far."""

    def flush(self) -> None:
        """Pass on what is buffered."""

    def close(self) -> None:
        """End the file."""


class Topic(NamedTuple):
    """A topic, its type (`pkg/msg/Name`), and the definition of that with those that it contains."""

    name: str
    type: str
    definition: str


class _Message(NamedTuple):
    topic: Topic
    time: int  # ns since 1970
    cdr: bytes


class BagWriter:
    """Recording, which a thread writes.

    Attributes:
        paths: The files so far.
        messages: Number of messages written.
        dropped: Messages that were dropped because the disk was too slow, by topic.
        error: Why the recording ended by itself; None while it goes on.
    """

    def __init__(self, path: Path, limits: Limits = NO_LIMITS, create: Callable[[Path], Output] | None = None) -> None:
        """Begin a recording.

        Args:
            path: The file, which must not exist; further ones are `NAME-1.mcap`, `NAME-2.mcap`, …
            limits: When the next file begins.
            create: Makes each file, on the disk unless given.

        Raises:
            InvalidRequest: The file exists or cannot be made.
            RceError: `create` raised it.
        """
        self.paths: list[Path] = []
        self.messages = 0
        self.dropped: Counter[str] = Counter()
        self.error: RceError | None = None
        self._path = path
        self._limits = limits
        self._create = create or _create
        self._waiting: queue.SimpleQueue[_Message | None] = queue.SimpleQueue()
        self._waiting_size = 0
        self._size_lock = threading.Lock()
        self._file = self._open()
        self._thread = threading.Thread(target=self._run, name="bag", daemon=True)
        self._thread.start()

    def put(self, topic: Topic, cdr: bytes, time: int) -> None:
        """Write a message with the time (ns since 1970) at which it arrived, or drop it if too much waits."""
        with self._size_lock:
            if self.error is not None or self._waiting_size + len(cdr) > MAX_WAITING:
                self.dropped[topic.name] += 1
                return
            self._waiting_size += len(cdr)
        self._waiting.put(_Message(topic, time, cdr))

    def close(self, dropped: Mapping[str, int]) -> None:
        """Write what waits, and the numbers of messages dropped before they arrived here; end the recording.

        Raises:
            RceError: It could not be written; `error` has the same.
        """
        self.dropped.update(dropped)
        self._waiting.put(None)
        self._thread.join()
        if self.error is not None:
            raise self.error

    # in the thread

    def _run(self) -> None:
        try:
            self._write()
            self._file.finish(self.dropped)
        except RceError as error:
            self._fail(error)
        except OSError as error:
            self._fail(disk_full(error) or InvalidRequest(f"the recording cannot be written: {error}"))

    def _fail(self, error: RceError) -> None:
        with self._size_lock:
            self.error = error
        self._file.abandon()
        with suppress(queue.Empty):
            while True:
                message = self._waiting.get_nowait()
                if message is not None:
                    self.dropped[message.topic.name] += 1

    def _write(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                message = self._waiting.get(timeout=FLUSH_INTERVAL)
            except queue.Empty:
                self._file.flush()
                continue
            if message is None:
                return
            with self._size_lock:
                self._waiting_size -= len(message.cdr)
            if self._file.is_full(self._limits):
                self._file.finish({})
                self._file = self._open()
            self._file.write(message)
            self.messages += 1
            if time.monotonic() > flushed + FLUSH_INTERVAL:
                self._file.flush()
                flushed = time.monotonic()

    def _open(self) -> _File:
        number = len(self.paths)
        path = self._path.with_stem(f"{self._path.stem}-{number}") if number else self._path
        file = _File(self._create(path))
        self.paths.append(path)
        return file


class _File:
    """One file of a recording."""

    def __init__(self, file: Output) -> None:
        self._file = file
        self._began = time.monotonic()
        self._writer = Writer(cast(IO[bytes], file), chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"rce {__version__}")
        self._channels: dict[str, int] = {}
        self._sequences: Counter[str] = Counter()

    def write(self, message: _Message) -> None:
        topic = message.topic
        channel = self._channels.get(topic.name)
        if channel is None:
            schema = self._writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
            channel = self._channels[topic.name] = self._writer.register_channel(topic.name, "cdr", schema)
        self._writer.add_message(channel, message.time, message.cdr, message.time, self._sequences[topic.name])
        self._sequences[topic.name] += 1

    def is_full(self, limits: Limits) -> bool:
        large = limits.size and self._file.tell() >= limits.size
        long = limits.seconds and time.monotonic() >= self._began + limits.seconds
        return bool(self._sequences and (large or long))

    def flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]  # the library annotates it without a result

    def finish(self, dropped: Mapping[str, int]) -> None:
        if dropped:
            self._writer.add_metadata(METADATA, {f"dropped {topic}": str(count) for topic, count in dropped.items()})
        self._writer.finish()  # type: ignore[no-untyped-call]  # as above
        self._file.close()

    def abandon(self) -> None:
        """Close a file that cannot be written, whose end is missing."""
        with suppress(OSError, RceError):
            self._file.close()


def _create(path: Path) -> Output:
    try:
        return path.open("xb")
    except OSError as error:
        raise disk_full(error) or InvalidRequest(f"cannot record into {path}: {error.strerror}") from None


def join_definitions(texts: Mapping[str, str], name: str) -> str:
    """Return the definition of a type with those that it contains, as a schema `ros2msg` has them.

    Args:
        texts: Text of each definition by name, `pkg/msg/Name`.
        name: Name of the first.
    """
    others = sorted(each for each in texts if each != name)
    separator = "=" * 80
    parts = [f"{separator}\nMSG: {each.replace('/msg/', '/')}\n{texts[each].rstrip()}\n" for each in others]
    return texts[name].rstrip() + "\n" + "".join(parts)
