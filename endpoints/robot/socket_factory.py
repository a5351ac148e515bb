"""Factory of clients' WebSockets: sets the options of Autobahn, and replaces parts of it that take much time.

Besides `client_socket`, this is the only module that uses Autobahn.
"""

from __future__ import annotations

import asyncio

import txaio
from autobahn.asyncio import websocket
from autobahn.asyncio.websocket import WebSocketServerFactory
from autobahn.websocket import protocol

from endpoints.data.turns import Turns
from endpoints.robot.client import Choose
from endpoints.robot.client_socket import ClientSocket
from endpoints.robot.framing import Unmasker
from rce.net.pending_logins import PendingLogin
from rce.net.writer import Passes


def _skip_format(_: object) -> str:
    return ""


# The first unmasks frames. The others format debug messages at each connection, even if these are not logged.
vars(protocol).update(create_xor_masker=Unmasker, pformat=_skip_format, hltype=_skip_format, hlval=_skip_format)
vars(websocket).update(hltype=_skip_format)


class SocketFactory(WebSocketServerFactory):
    """Makes the sockets of a server."""

    def __init__(self, turns: Turns, choose: Choose, limit: int, handshake_timeout: float) -> None:
        """Create the factory.

        Args:
            turns: Turns of users at the event loop.
            choose: Returns the client for the path of a request.
            limit: Bytes of a message.
            handshake_timeout: Seconds for the opening handshake, with the login.
        """
        loop = asyncio.get_running_loop()
        txaio.config.loop = loop  # type: ignore[attr-defined]  # Autobahn's ping and handshake timers run on it
        super().__init__(server="RCE", loop=loop)
        self._turns = turns
        self._passes = Passes()
        self._choose = choose
        self.setProtocolOptions(
            maxMessagePayloadSize=limit,
            maxFramePayloadSize=limit,
            allowNullOrigin=True,  # the origin of a page from a file; setProtocolOptions would reset it
            openHandshakeTimeout=handshake_timeout,
            closeHandshakeTimeout=1,  # a connection that was cut off is gone by then
            failByDrop=False,  # tell the robot which rule it broke
            utf8validateIncoming=False,  # the decoders validate it, so the robot gets an error and keeps its socket
        )
        # Autobahn copies its options into each socket, unless the socket's class has them. A function would become a
        # method of the class, so those are copied.
        options = {name: getattr(self, name) for name in ClientSocket.CONFIG_ATTRS}
        values = {name: option for name, option in options.items() if not callable(option)}
        self._kind: type[ClientSocket] = type("ClientSocket", (ClientSocket,), values)

    def make(self, pending: PendingLogin) -> ClientSocket:
        """Return the protocol of a new connection."""
        socket = self._kind(self._turns, self._passes, self._choose, pending)
        socket.factory = self  # type: ignore[attr-defined]  # as the base class does
        return socket
