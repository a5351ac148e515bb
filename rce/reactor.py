"""Twisted's asyncio reactor, mended for uvloop.

When a socket reports an error while data still waits in it (the other side was killed), uvloop calls the reader once
and then closes its watch, but keeps the closed watch in its table: the reader takes the data, never hears of the error,
and the next attempt to watch that socket raises RuntimeError. So after each event a watch that was closed is renewed.
"""

from __future__ import annotations

from typing import Any

from twisted.internet.asyncioreactor import AsyncioSelectorReactor


class UvloopReactor(AsyncioSelectorReactor):
    """What is watched is Twisted's: any object with a `fileno`."""

    def addReader(self, reader: Any) -> None:
        try:
            super().addReader(reader)
        except RuntimeError:
            self._asyncioEventloop.remove_reader(reader.fileno())
            super().addReader(reader)

    def addWriter(self, writer: Any) -> None:
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
