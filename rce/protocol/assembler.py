"""Assembly of messages from the text frames and blobs of one connection. No I/O."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from rce.errors import InvalidRequest, LimitExceeded, RceError, TimedOut
from rce.protocol.blobs import ID_SIZE, POSITION, Buffer, find_references
from rce.protocol.buffers import uninitialized
from rce.protocol.messages import Frame

_id = re.compile(rb"[0-9a-fA-F]{32}")


class AssemblyLimits(NamedTuple):
    """Limits for the unfinished messages of one connection.

    Attributes:
        blobs: Number of blobs that are awaited or held.
        memory: Bytes of all unfinished messages.
        message: Bytes of one message with its blobs.
        age: Seconds until an unfinished message is dropped.
    """

    blobs: int = 64
    memory: int = 256 * 1024 * 1024
    message: int = 64 * 1024 * 1024
    age: float = 60.0


class Assembled(NamedTuple):
    """A text frame with all of its blobs."""

    frame: Frame
    blobs: Mapping[str, Buffer]


class Dropped(NamedTuple):
    """A text frame that never got all of its blobs or, with `frame` None, a blob without a frame, and the reason."""

    frame: Frame | None
    error: RceError


class AssemblyResult(NamedTuple):
    """Result of adding a frame: the message that it completed, and the messages dropped to make room."""

    complete: Assembled | None = None
    dropped: Sequence[Dropped] = ()


class _Part(NamedTuple):
    """Part of a blob: its id, offset, and length of all of its fragments, and the length of the whole blob."""

    name: str
    offset: int
    total: int
    length: int
    content: Sequence[memoryview]


class _Blob:
    """A blob of `size` bytes, of which the first `filled` have come.

    Its parts are copied into their place as they come. The memory of the rest is not touched before: a part may
    announce more than ever follows.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.filled = 0
        self.content: Buffer = b""
        self._rest: memoryview | None = None  # where the next fragment goes

    @property
    def complete(self) -> bool:
        return self.filled == self.size

    def add(self, fragment: memoryview) -> None:
        if len(fragment) == self.size:  # all of it, which is not copied
            self.content = fragment
        else:
            if self._rest is None:
                self.content, self._rest = uninitialized(self.size)
            self._rest[: len(fragment)] = fragment
            self._rest = self._rest[len(fragment) :]
        self.filled += len(fragment)


@dataclass(slots=True, eq=False)
class _Group:
    """A text frame and its blobs, None for those of which nothing has come; or a blob whose frame has not come."""

    frame: Frame | None
    blobs: dict[str, _Blob | None]
    size: int
    used_at: float = 0.0

    def assembled(self) -> Assembled | None:
        if self.frame is None or not all(blob is not None and blob.complete for blob in self.blobs.values()):
            return None
        return Assembled(self.frame, {name: blob.content for name, blob in self.blobs.items() if blob is not None})


class Assembler:
    """Joins the text and binary frames of one connection, in whichever order they come.

    When a limit is exceeded, the least recently used message is dropped. Each blob that arrives renews the age of its
    message.
    """

    def __init__(self, time: Callable[[], float], *, parts: bool = False, limits: AssemblyLimits | None = None) -> None:
        """Make an empty assembler.

        Args:
            time: A monotonic clock, in seconds.
            parts: True if the connection has the feature `parts`.
            limits: Limits for unfinished messages.
        """
        self._time = time
        self._parts = parts
        self._limits = limits or AssemblyLimits()
        self._groups: dict[_Group, None] = {}  # least recently used first
        self._group_of: dict[str, _Group] = {}
        self._memory = 0
        self._ignored: dict[str, None] = {}  # ids of dropped blobs of which parts may still come

    def add_frame(self, frame: Frame) -> AssemblyResult:
        """Add a text frame; without references it is complete at once.

        Raises:
            InvalidRequest: A reference is malformed, or another frame waits for the same blob.
        """
        try:
            ids = find_references(frame.data, self._limits.blobs)
        except LimitExceeded as error:
            return AssemblyResult(None, (Dropped(frame, error),))
        if not ids:
            return AssemblyResult(Assembled(frame, {}))
        group = _Group(frame, {}, len(memoryview(frame.data)))
        lone = [self._group_of[name] for name in ids if name in self._group_of]
        if any(other.frame is not None for other in lone):
            raise InvalidRequest("the frame refers to a blob for which an earlier frame still waits: use new ids")
        for other in lone:
            self._remove(other)
            group.blobs.update(other.blobs)
            group.size += other.size
        group.blobs.update({name: None for name in ids if name not in group.blobs})
        for name in ids:
            self._ignored.pop(name, None)
        return self._settle(group)

    def add_blob(self, *fragments: Buffer) -> AssemblyResult:
        """Add a binary frame, whole or in the fragments in which it came, which need not be joined first.

        Raises:
            InvalidRequest: The frame is malformed, or its part is out of order.
        """
        name, offset, total, length, content = self._split(fragments)
        group = self._group_of.get(name)
        if group is None and name in self._ignored:
            if offset + length == total:
                del self._ignored[name]
            return AssemblyResult()
        before = group.blobs[name] if group is not None else None
        if offset and (before is None or before.filled != offset or before.size != total):
            raise InvalidRequest(f"blob {name}: the part at offset {offset} does not follow the parts received so far")
        if group is None:
            group = _Group(None, {name: None}, 0)
        else:
            self._remove(group)
        if offset == 0:
            group.size += total - (before.size if before is not None else 0)
        if group.size <= self._limits.message:
            blob = before if before is not None and offset else _Blob(total)
            for fragment in content:
                blob.add(fragment)
            group.blobs[name] = blob
        return self._settle(group)

    def sweep(self) -> Sequence[Dropped]:
        """Drop the messages that are too old. Call it every few seconds."""
        oldest = self._time() - self._limits.age
        old = [group for group in self._groups if group.used_at <= oldest]
        return [self._drop(group, TimedOut(f"incomplete for {self._limits.age:g} s")) for group in old]

    def _split(self, fragments: Sequence[Buffer]) -> _Part:
        size = ID_SIZE + (POSITION.size if self._parts else 0)
        if len(fragments) > 1 and len(fragments[0]) < size:
            fragments = (b"".join(fragments),)
        views = [memoryview(fragment) for fragment in fragments]
        first = views[0]
        if len(first) < size or not _id.fullmatch(first[:ID_SIZE]):
            raise InvalidRequest(f"a binary frame must begin with an id of 32 hex digits (a head of {size} bytes)")
        content = [first[size:], *views[1:]]
        length = sum(map(len, content))
        name = str(first[:ID_SIZE], "ascii")
        if not self._parts:
            return _Part(name, 0, length, length, content)
        offset, total = POSITION.unpack_from(first, ID_SIZE)
        if offset + length > total or (total and not length):
            raise InvalidRequest(
                f"blob {name}: a part of {length} bytes at offset {offset} does not fit a blob of {total} bytes"
            )
        return _Part(name, offset, total, length, content)

    def _settle(self, group: _Group) -> AssemblyResult:
        """Return a complete message, or keep the group as the most recently used and make room for it."""
        limits = self._limits
        if group.size > limits.message:
            why = f"a message of {group.size} bytes, with its blobs, exceeds the limit of {limits.message} bytes"
            return AssemblyResult(None, (self._drop(group, LimitExceeded(why, bytes=limits.message)),))
        complete = group.assembled()
        if complete is not None:
            return AssemblyResult(complete)
        group.used_at = self._time()
        self._groups[group] = None
        self._group_of.update(dict.fromkeys(group.blobs, group))
        self._memory += group.size
        dropped: tuple[Dropped, ...] = ()
        while len(self._group_of) > limits.blobs or self._memory > max(limits.memory, limits.message):
            why = f"the connection has more than {limits.blobs} blobs or {limits.memory} bytes of unfinished messages"
            dropped += (self._drop(next(iter(self._groups)), LimitExceeded(why)),)
        return AssemblyResult(None, dropped)

    def _drop(self, group: _Group, error: RceError) -> Dropped:
        self._remove(group)
        self._ignored.update((name, None) for name, blob in group.blobs.items() if blob is None or not blob.complete)
        while len(self._ignored) > 4 * self._limits.blobs:
            del self._ignored[next(iter(self._ignored))]
        return Dropped(group.frame, error)

    def _remove(self, group: _Group) -> None:
        if group in self._groups:
            del self._groups[group]
            self._memory -= group.size
            for name in group.blobs:
                del self._group_of[name]
