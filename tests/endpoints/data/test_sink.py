"""Sinks: always open, and with room."""

from __future__ import annotations

import asyncio

import pytest

from endpoints.data.frames import Message
from endpoints.data.link import Link
from endpoints.data.sink import Sink


async def test_sink_is_an_open_link_in_which_nothing_waits() -> None:
    sink = Sink()
    link: Link = sink
    assert link.opened.done()
    assert link.wait_for_room(b"") is None
    assert link.backlog(b"") == 0
    link.discard(b"")
    link.pause(asyncio.get_running_loop().create_future())
    link.close()
    with pytest.raises(NotImplementedError):
        sink.send(Message(bytes(16), "1", b""), None)
