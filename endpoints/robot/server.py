"""WebSocket server for robots and for clients of gateways."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from endpoints.robot.client import Choose, Client, RobotClient
from endpoints.robot.endpoint import RobotEndpoint
from endpoints.robot.socket_factory import SocketFactory
from rce.net.listener import Listener, bind

HANDSHAKE_TIMEOUT = 30.0  # seconds for the opening handshake, with the login
NO_GATEWAYS: Mapping[str, Choose] = MappingProxyType({})


async def listen(
    endpoint: RobotEndpoint,
    host: str,
    port: int,
    tls: Any,
    gateways: Mapping[str, Choose] = NO_GATEWAYS,
    shared: bool = False,
) -> Listener:
    """Serve robots and clients of gateways at `host:port`.

    Args:
        endpoint: The endpoint, which has the sessions.
        host: Local address.
        port: Port; 0 for any free one.
        tls: SSLContext for wss; None for ws.
        gateways: By the first part of a path: makes the client for the rest of the path. Other paths are robots'.
        shared: Other processes of this machine may serve robots at the same port.

    Raises:
        Unavailable: The port cannot be bound.
    """

    def choose(path: str) -> Client:
        name, _, rest = path.strip("/").partition("/")
        return gateways[name](rest) if name in gateways else RobotClient(endpoint)

    factory = SocketFactory(endpoint.switchboard.turns, choose, endpoint.limits.message, HANDSHAKE_TIMEOUT)
    return Listener(bind(host, port, shared=shared), factory.make, tls)
