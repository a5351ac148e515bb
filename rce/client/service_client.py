"""Blocking HTTP client of a service beside the Master, with the standard library and msgspec alone."""

from __future__ import annotations

import base64
import contextlib
import http.client
import ssl as tls
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, ClassVar, NamedTuple, TypeVar
from urllib.parse import urlsplit

import msgspec

from rce.api.entries import entries
from rce.api.http import Problem, reason_of
from rce.errors import MALFORMED, ErrorInfo, InvalidRequest, NotFound, RceError, TimedOut, Unavailable

TIMEOUT = 60.0
PIECE = 1024 * 1024  # bytes of a response that are read at once
DATA = b"data: "  # before the content of a server-sent event

T = TypeVar("T")


class Answer(NamedTuple):
    """HTTP response that has been read."""

    status: int
    headers: http.client.HTTPMessage
    body: bytes


class ServiceClient:
    """Client of a service, which connects anew for each request.

    Attributes:
        prefix: Prefix of the service's paths, which is a slash and its name.
        headers: Headers of each request.
    """

    prefix: ClassVar[str]

    def __init__(
        self,
        url: str,
        *,
        user: str = "",
        password: str | None = None,
        key: str | None = None,
        ssl: tls.SSLContext | None = None,
    ) -> None:
        """Prepare a client; nothing is sent yet.

        Args:
            url: URL of the platform's entry, which redirects to the service, or of the service itself; those of several
                Masters are separated by commas.
            user: User name, with a password.
            password: Password in clear. Give either this or `key`.
            key: API key.
            ssl: TLS context for https in place of the system's certificates.

        Raises:
            InvalidRequest: The URL is not http or https, or not exactly one of `password` and `key` is given.
        """
        self._bases = [each.rstrip("/").removesuffix(self.prefix) for each in entries(url)]
        if (password is None) == (key is None):
            raise InvalidRequest("give either a password or an API key", field="password")
        secret = f"Bearer {key}" if key else "Basic " + base64.b64encode(f"{user}:{password}".encode()).decode()
        self.headers = {"Authorization": secret}
        self._ssl = ssl
        self._name = self.prefix.strip("/")
        self._title = self._name.replace("-", " ")
        self._base = self._bases[0]
        self._located = False

    def ask(
        self, method: str, path: str, body: bytes | IO[bytes] | None = None, headers: dict[str, str] | None = None
    ) -> Answer:
        """Make a request; raises Unavailable without a response, and the error of a response that has one."""
        try:
            with self.connected() as connection:
                connection.request(method, self.prefix + path, body, self.headers | (headers or {}))
                response = connection.getresponse()
                answer = Answer(response.status, response.headers, response.read())
        except (OSError, http.client.HTTPException) as error:
            raise _unreachable(self._base, error) from None
        if answer.status >= 300:
            raise self.error(answer)
        return answer

    def pieces(self, path: str, headers: Mapping[str, str] | None = None, status: int = 200) -> Iterator[bytes]:
        """Yield the body of a GET in pieces.

        Args:
            path: Path below the prefix.
            headers: Headers beside those of each request.
            status: Expected status.

        Raises:
            Unavailable: The service cannot be reached, or the connection was cut off.
            TimedOut: Nothing came for TIMEOUT seconds.
            RceError: The error that a response of another status describes.
        """
        with self._response(path, headers or {}, status) as response:
            while piece := response.read(PIECE):
                yield piece
            if response.length:
                raise Unavailable(f"the connection was cut off: {response.length} bytes are missing; try again")

    def events(self, path: str, kind: type[T]) -> Iterator[T]:
        """Yield the server-sent events of a path, until the connection ends; raises as `pieces`."""
        with self._response(path, {}, 200) as response:
            while line := response.readline():
                if line.startswith(DATA):
                    yield msgspec.json.decode(line[len(DATA) :], type=kind)

    def download(self, path: str, file: Path) -> None:
        """Store the body of a GET in a file, under a temporary name until it is complete; raises as `pieces`."""
        draft = file.with_name(f".{file.name}.part")
        try:
            with draft.open("wb") as out:
                for piece in self.pieces(path):
                    out.write(piece)
            draft.rename(file)
        finally:
            draft.unlink(missing_ok=True)

    @contextlib.contextmanager
    def _response(self, path: str, headers: Mapping[str, str], status: int) -> Iterator[http.client.HTTPResponse]:
        """Give the response to a GET, whose body is not read yet."""
        try:
            with self.connected() as connection:
                connection.request("GET", self.prefix + path, headers={**self.headers, **headers})
                response = connection.getresponse()
                if response.status != status:
                    raise self.error(Answer(response.status, response.headers, response.read()))
                yield response
        except TimeoutError:
            raise TimedOut(f"{self._base} sent nothing for {TIMEOUT:g} s") from None
        except (OSError, http.client.HTTPException) as error:
            raise _unreachable(self._base, error) from None

    @contextlib.contextmanager
    def connected(self) -> Iterator[http.client.HTTPConnection]:
        """Give a connection to the service, which is found with the first one; raises as `ask`."""
        if not self._located:
            self._base = self._locate()
            self._located = True
        connection = self._connection(self._base)
        try:
            yield connection
        finally:
            connection.close()

    def _connection(self, url: str) -> http.client.HTTPConnection:
        parts = urlsplit(url)
        if parts.scheme == "https":
            return http.client.HTTPSConnection(parts.netloc, timeout=TIMEOUT, context=self._ssl)
        return http.client.HTTPConnection(parts.netloc, timeout=TIMEOUT)

    def _locate(self) -> str:
        """Return the URL of the service, to which the entry of the Master that leads redirects."""
        for base in self._bases[:-1]:
            with contextlib.suppress(Unavailable):
                return self._locate_at(base)
        return self._locate_at(self._bases[-1])

    def _locate_at(self, base: str) -> str:
        connection = self._connection(base)
        try:
            connection.request("GET", self.prefix + "/")
            response = connection.getresponse()
            response.read()
        except (OSError, http.client.HTTPException) as error:
            raise _unreachable(base, error) from None
        finally:
            connection.close()
        location = response.headers.get("Location", "")
        if response.status == 307 and location:
            return location.rstrip("/").removesuffix(self.prefix)
        if response.status == 200:
            return base
        if response.status == 503:
            raise Unavailable(f"the {self._title} of {base} is not connected at present; try again in a moment")
        raise NotFound(f"the platform at {base} has no {self._title}: start `rce {self._name}` there", field="url")

    @staticmethod
    def value(answer: Answer, kind: type[T]) -> T:
        """Return the JSON of an answer as a value of this type."""
        return msgspec.json.decode(answer.body, type=kind)

    def error(self, answer: Answer) -> RceError:
        """Return the error that an answer describes."""
        try:
            problem = msgspec.json.decode(answer.body, type=Problem)
        except MALFORMED:
            return Unavailable(f"the {self._title} answered with HTTP status {answer.status}")
        return RceError.from_info(ErrorInfo(problem.code, problem.detail, "", problem.field, problem.fields))


def _unreachable(url: str, error: Exception) -> Unavailable:
    return Unavailable(f"cannot reach {url}: {reason_of(error) or type(error).__name__}")
