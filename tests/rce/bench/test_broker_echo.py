"""Server of the bare calls by Perspective Broker."""

from __future__ import annotations

import asyncio

from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.spread import pb

from rce.bench.broker_echo import Echo, NoDelayFactory


async def test_value_comes_back(reactor: ReactorBase) -> None:
    loop = asyncio.get_running_loop()
    listening = endpoints.TCP4ServerEndpoint(reactor, 0, interface="127.0.0.1").listen(NoDelayFactory(Echo()))
    port = await listening.asFuture(loop)
    factory = pb.PBClientFactory()
    await endpoints.TCP4ClientEndpoint(reactor, "127.0.0.1", port.getHost().port).connect(factory).asFuture(loop)
    root = await factory.getRootObject().asFuture(loop)
    assert await root.callRemote("echo", b"value").asFuture(loop) == b"value"
    factory.disconnect()
    await port.stopListening().asFuture(loop)
