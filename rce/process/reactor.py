"""Twisted's asyncio reactor with a workaround for uvloop.

When a socket reports an error while it still has data to read (the peer was killed), uvloop calls the reader once and
then closes its poll handle, but keeps the closed handle in its table. The reader gets the data but never the error, and
the next `add_reader` for that socket raises RuntimeError. This reactor therefore registers a reader again after each
event.
"""

from __future__ import annotations

from typing import Any

from twisted.internet.asyncioreactor import AsyncioSelectorReactor


class UvloopReactor(AsyncioSelectorReactor):
    """AsyncioSelectorReactor that registers readers again after each event."""

    def addReader(self, reader: Any) -> None:
        """Watch a selectable for reading."""
        try:
            super().addReader(reader)
        except RuntimeError:
            self._asyncioEventloop.remove_reader(reader.fileno())
            super().addReader(reader)

    def addWriter(self, writer: Any) -> None:
        """Watch a selectable for writing."""
        try:
            super().addWriter(writer)
        except RuntimeError:
            self._asyncioEventloop.remove_writer(writer.fileno())
            super().addWriter(writer)

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
