"""Server of the bare calls by Perspective Broker: `python -m rce.bench.broker_echo`.

It prints its port. Needs the extra `server`.
"""

from __future__ import annotations

import asyncio
import sys

from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.spread import pb

from rce.control.connection import disable_nagle
from rce.process import loop


class Echo(pb.Root):
    """Object that returns what it is given."""

    def remote_echo(self, value: bytes) -> bytes:
        """Return the value."""
        return value


class NoDelayFactory(pb.PBServerFactory):
    """Factory of connections that send at once, as the Master's control connections do."""

    def clientConnectionMade(self, protocol: pb.Broker) -> None:
        """Switch Nagle's algorithm off."""
        disable_nagle(protocol.transport)


async def serve(reactor: ReactorBase) -> None:
    """Serve on a free port of the loopback address until cancelled."""
    factory = NoDelayFactory(Echo())  # type: ignore[no-untyped-call]  # of Twisted
    listening = endpoints.TCP4ServerEndpoint(reactor, 0, interface="127.0.0.1").listen(factory)
    port = await listening.asFuture(asyncio.get_running_loop())
    print(port.getHost().port, flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    sys.exit(loop.run(serve))
