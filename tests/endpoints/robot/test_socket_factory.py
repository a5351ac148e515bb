"""Options of clients' sockets."""

from __future__ import annotations

from unittest.mock import Mock

from endpoints.data.turns import Turns
from endpoints.robot.client_socket import ClientSocket
from endpoints.robot.socket_factory import SocketFactory


async def test_options_are_of_the_class_of_a_factory() -> None:
    sockets = [SocketFactory(Turns(), Mock(), limit, 30.0).make(Mock()) for limit in (1000, 2000)]
    assert [socket.maxMessagePayloadSize for socket in sockets] == [1000, 2000]
    for socket in sockets:
        assert isinstance(socket, ClientSocket)
        assert not vars(socket).keys() & {"maxMessagePayloadSize", "utf8validateIncoming", "versions"}
        assert not hasattr(socket, "perMessageCompressionAccept"), "a function would become a method"
