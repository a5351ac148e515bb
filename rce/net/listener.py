"""Listening sockets for robots and users, with bounds on clients without a login and on the time of a TLS handshake.

The listener accepts by itself, because a server of asyncio learns the address of a client only after the TLS handshake.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
from collections.abc import Callable

from rce.errors import describe_os_error, port_unavailable
from rce.net.pending_logins import PendingLogin, PendingLogins

TLS_TIMEOUT = 20.0  # seconds for a TLS handshake
# Connections that wait to be accepted. All processes and robots of a platform return at once after a restart of the
# Master: with the usual 50 or 128, most of them would wait for the retransmissions of TCP. Linux permits so many.
BACKLOG = 4096
BATCH = 2  # connections that are accepted in a pass of the event loop: with their logins they take a millisecond
PAUSE = 1.0  # seconds without accepting after the system refused to, as a rule for lack of file descriptors

log = logging.getLogger(__name__)


def bind(host: str, port: int, backlog: int = BACKLOG, shared: bool = False) -> socket.socket:
    """Return a listening TCP socket; port 0 takes a free one.

    The kernel divides the connections to a `shared` port among the processes of this user that listen at it.

    Raises:
        Unavailable: The port is in use or cannot be bound.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        # `::` means all addresses, those of IPv4 too.
        return socket.create_server(
            (host, port), family=family, backlog=backlog, reuse_port=shared, dualstack_ipv6=host == "::"
        )
    except OSError as error:
        raise port_unavailable(host, port, error) from None


class Listener:
    """Accepts connections at a socket until it is closed; those that were accepted stay open."""

    def __init__(
        self,
        listening: socket.socket,
        make_protocol: Callable[[PendingLogin], asyncio.Protocol],
        tls: ssl.SSLContext | None,
    ) -> None:
        """Begin to accept.

        Args:
            listening: The socket, which the listener closes.
            make_protocol: Makes the protocol of a connection, which ends the PendingLogin when its client has logged in
                or the connection is lost.
            tls: Makes it a TLS port.
        """
        self.pending = PendingLogins()
        self._socket = listening
        self._make_protocol = make_protocol
        self._tls = tls
        self._loop = asyncio.get_running_loop()
        self._handshakes: set[asyncio.Task[None]] = set()
        self._pause: asyncio.TimerHandle | None = None
        listening.setblocking(False)
        self._resume()

    @property
    def port(self) -> int:
        """Port of the socket."""
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        """Stop to accept, and free the port."""
        if self._pause is not None:
            self._pause.cancel()
        else:
            self._loop.remove_reader(self._socket)
        self._socket.close()
        for handshake in self._handshakes:
            handshake.cancel()

    def _resume(self) -> None:
        self._pause = None
        self._loop.add_reader(self._socket, self._accept)

    def _accept(self) -> None:
        for _ in range(BATCH):
            try:
                connection, address = self._socket.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                log.error("cannot accept connections: %s", describe_os_error(error))
                self._loop.remove_reader(self._socket)
                self._pause = self._loop.call_later(PAUSE, self._resume)
                return
            pending = self.pending.begin(address[0])
            if pending is None:
                connection.close()
                continue
            connection.setblocking(False)
            handshake = self._loop.create_task(self._connect(connection, pending))
            self._handshakes.add(handshake)
            handshake.add_done_callback(self._handshakes.discard)

    async def _connect(self, connection: socket.socket, pending: PendingLogin) -> None:
        timeout = TLS_TIMEOUT if self._tls else None
        try:
            await self._loop.connect_accepted_socket(
                lambda: self._make_protocol(pending), connection, ssl=self._tls, ssl_handshake_timeout=timeout
            )
        except OSError:  # the TLS handshake failed or took too long, or the client is gone
            pending.end()
        except BaseException:
            pending.end()
            raise
