"""Transfer of a recording from an environment to the store of its machine, over a UNIX socket.

The environment sends a line with the tag of the recorder, and waits for a verdict. Then it sends the bytes of the file,
shuts its side down, and waits for a second verdict: the file is stored. The store sends a verdict in between, and
closes, if it cannot take more. A verdict is a line of JSON.
"""

from __future__ import annotations

import socket
from pathlib import Path

import msgspec
from msgspec import Struct

from rce.errors import MALFORMED, ErrorInfo, RceError, Unavailable
from rce.net.sockets import unix_socket_path

SOCKET = "recordings.sock"
MAX_LINE = 16_384  # bytes
TIMEOUT = 30.0  # seconds in which the store takes or says something


class Verdict(Struct, frozen=True, omit_defaults=True):
    """Answer of the store; without an error it agrees."""

    error: ErrorInfo | None = None

    def line(self) -> bytes:
        """Return the line that is sent."""
        return msgspec.json.encode(self) + b"\n"


class Broken(Unavailable):
    """The store of recordings cannot be reached at present. Begin another file."""


class StoredFile:
    """File at the store, of which only the end can be written."""

    def __init__(self, path: Path, recorder: str) -> None:
        """Begin a file.

        Args:
            path: Socket of the store.
            recorder: Tag of the recorder.

        Raises:
            Broken: The store cannot be reached.
            RceError: It refuses the file.
        """
        self._size = 0
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(TIMEOUT)
        try:
            with unix_socket_path(path) as short:
                self._socket.connect(short)
            self._socket.sendall(recorder.encode() + b"\n")
            self._wait()
        except OSError as error:
            self._socket.close()
            raise Broken(f"the store of recordings cannot be reached: {error}") from None
        except RceError:
            self._socket.close()
            raise

    def write(self, data: bytes) -> int:
        """Send bytes.

        Raises:
            Broken: The connection broke.
            RceError: The store takes no more.
        """
        try:
            self._socket.sendall(data)
        except TimeoutError:
            raise Broken(f"the store of recordings took nothing for {TIMEOUT:g} s") from None
        except OSError:
            self._wait()
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes so far."""
        return self._size

    def flush(self) -> None:
        """Do nothing: all bytes have been sent."""

    def close(self) -> None:
        """End the file, and return when it is stored; one that is closed already stays as it is.

        Raises:
            Broken: The connection broke, so that it may have no end.
            RceError: It could not be stored.
        """
        if self._socket.fileno() < 0:
            return
        try:
            self._socket.shutdown(socket.SHUT_WR)
            self._wait()
        except OSError as error:
            raise Broken(f"the store of recordings was lost: {error}") from None
        finally:
            self._socket.close()

    def _wait(self) -> None:
        """Wait for a verdict; raise its error."""
        line = b""
        try:
            while not line.endswith(b"\n") and len(line) < MAX_LINE:
                data = self._socket.recv(MAX_LINE)
                if not data:
                    raise Broken("the store of recordings was lost")
                line += data
            verdict = msgspec.json.decode(line, type=Verdict)
        except OSError as error:
            raise Broken(f"the store of recordings was lost: {error}") from None
        except MALFORMED:
            raise Broken("the store of recordings answered with something else") from None
        if verdict.error is not None:
            raise RceError.from_info(verdict.error)
