"""Ports that stay the same over restarts of the task set."""

from __future__ import annotations

import socket

import pytest
from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.internet.protocol import Factory, Protocol

from containers.ports import close_port, listen_again
from rce.errors import Unavailable


class Listener:
    """`listen` of a server, which cannot have the ports in `taken`."""

    def __init__(self, error: Exception, *taken: int) -> None:
        self.asked: list[int] = []
        self._error = error
        self._taken = taken

    async def listen(self, port: int) -> int:
        self.asked.append(port)
        if port in self._taken:
            raise self._error
        return port or 7000


ERRORS = [CannotListenError("", 5000, OSError("in use")), Unavailable("port 5000 is in use")]


async def test_port_of_last_time_is_taken_again() -> None:
    listener = Listener(ERRORS[0])
    assert await listen_again(listener.listen, 5000) == 5000
    assert listener.asked == [5000]


@pytest.mark.parametrize("error", ERRORS, ids=["twisted", "aiohttp"])
async def test_port_in_use_is_replaced_by_a_free_one(error: Exception) -> None:
    listener = Listener(error, 5000)
    assert await listen_again(listener.listen, 5000) == 7000
    assert listener.asked == [5000, 0]


@pytest.mark.parametrize("error", ERRORS, ids=["twisted", "aiohttp"])
@pytest.mark.parametrize("previous", [0, 5000])
async def test_address_that_cannot_be_used_is_an_error(error: Exception, previous: int) -> None:
    with pytest.raises(type(error)):
        await listen_again(Listener(error, 0, 5000).listen, previous)


async def test_closed_port_is_free_at_once(reactor: ReactorBase) -> None:
    port = reactor.listenTCP(0, Factory.forProtocol(Protocol), interface="127.0.0.1")  # type: ignore[attr-defined]
    number = port.getHost().port
    await close_port(port)
    with socket.create_server(("127.0.0.1", number)):
        pass
