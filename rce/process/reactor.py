"""Twisted's asyncio reactor, made to fit uvloop.

When a socket reports an error while it still has data to read (the peer was killed), uvloop calls the reader once and
then closes its poll handle, but keeps the closed handle in its table. The reader gets the data but never the error, and
the next `add_reader` for that socket raises RuntimeError. This reactor therefore registers a reader again after each
event.

Twisted waits until a socket is writable before it writes to it, which takes two system calls more and another turn of
the loop, although nearly every socket is. This reactor writes first, and waits only if the kernel does not take
everything.
"""

from __future__ import annotations

from typing import Any

from twisted.internet.asyncioreactor import AsyncioSelectorReactor


class UvloopReactor(AsyncioSelectorReactor):
    """AsyncioSelectorReactor that registers readers again after each event, and writes before it waits."""

    def __init__(self, loop: Any) -> None:
        self._unwritten: set[Any] = set()  # writers that are written to in the next turn of the loop
        super().__init__(loop)

    def addReader(self, reader: Any) -> None:
        """Watch a selectable for reading."""
        try:
            super().addReader(reader)
        except RuntimeError:
            self._asyncioEventloop.remove_reader(reader.fileno())
            super().addReader(reader)

    def addWriter(self, writer: Any) -> None:
        """Write what a connection has in the next turn of the loop; watch other selectables for writing."""
        if writer in self._writers or writer in self._unwritten:
            return
        if getattr(
            writer, "connected", False
        ):  # `doWrite` would tell a socket that still connects that it is connected
            self._unwritten.add(writer)
            self._asyncioEventloop.call_soon(self._write, writer)
        else:
            self._watch_writer(writer)

    def _watch_writer(self, writer: Any) -> None:
        try:
            super().addWriter(writer)
        except RuntimeError:
            self._asyncioEventloop.remove_writer(writer.fileno())
            super().addWriter(writer)

    def _write(self, writer: Any) -> None:
        if writer not in self._unwritten:
            return
        super()._readOrWrite(writer, False)
        if writer in self._unwritten:  # the kernel did not take everything
            self._unwritten.discard(writer)
            self._watch_writer(writer)

    def removeWriter(self, writer: Any) -> None:
        """Stop to watch a selectable for writing."""
        self._unwritten.discard(writer)
        super().removeWriter(writer)

    def getWriters(self) -> list[Any]:
        """Return the selectables that are watched for writing, or about to be written to."""
        return [*super().getWriters(), *self._unwritten]

    def _readOrWrite(self, selectable: Any, read: bool) -> None:
        super()._readOrWrite(selectable, read)
        if selectable in self._readers:
            self._asyncioEventloop.call_soon(self._renew, selectable)

    def _renew(self, selectable: Any) -> None:
        fd = self._readers.get(selectable)
        if fd is None:
            return
        try:
            self._asyncioEventloop.add_reader(fd, self._readOrWrite, selectable, True)
        except RuntimeError:
            self._asyncioEventloop.remove_reader(fd)
            self._asyncioEventloop.add_reader(fd, self._readOrWrite, selectable, True)
