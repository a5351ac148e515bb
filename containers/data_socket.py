"""Listening socket for the data links of an environment in a container.

All environments of a user see the directory of these sockets, and none can write to it: the platform binds the sockets.
It passes the listening socket to whoever connects first to `listener.sock` in the environment's control directory,
which only this environment sees. That is its endpoint, as nodes start later.
"""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress
from pathlib import Path

from twisted.logger import Logger

from rce.net.sockets import bind_unix_socket, send_socket

log = Logger()
OFFER = "listener.sock"
BACKLOG = 100


class DataSocket:
    """The socket at `path`, on which one environment accepts data links.

    It is given away once. More would be harmful: the kernel limits how many descriptors of the platform's user are
    under way, and an environment that does not receive them could use up all of them.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offer: Path | None = None
        self._server: socket.socket | None = None

    def offer(self, directory: Path) -> None:
        """Create `listener.sock` in a directory; an earlier socket at the same path is replaced.

        Raises:
            OSError: The socket cannot be created.
        """
        self._offer = directory / OFFER
        self._server = bind_unix_socket(self._offer, 0o666)
        self._server.listen()
        self._server.setblocking(False)
        asyncio.get_running_loop().add_reader(self._server, self._give)

    def close(self) -> None:
        """Stop offering the socket; an environment that has it keeps it."""
        if self._server is not None and self._offer is not None:
            asyncio.get_running_loop().remove_reader(self._server)
            self._server.close()
            self._server = None
            with suppress(OSError):
                self._offer.unlink()

    def remove(self) -> None:
        """Stop offering the socket, and remove it."""
        self.close()
        with suppress(OSError):
            self._path.unlink()

    def _give(self) -> None:
        assert self._server is not None
        try:
            with (
                self._server.accept()[0] as connection,
                bind_unix_socket(self._path, 0o666) as listener,  # other environments of its user connect to it
            ):
                listener.listen(BACKLOG)
                send_socket(connection, listener)
        except OSError as error:
            log.error("{path} was not given to its environment: {error}", path=str(self._path), error=str(error))
            return
        self.close()
