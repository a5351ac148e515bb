"""Requests as handlers of the API see them, and the answers that handlers return."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from aiohttp import web
from msgspec import Meta, Struct

from master.access.audit import names_of
from master.access.rights import Principal
from master.api.downloads import Download
from master.api.streams import EventStream
from master.storage.depot import Upload
from rce.choices import with_choices
from rce.errors import InvalidRequest
from rce.protocol.messages import decode_as
from rce.protocol.names import TAG
from rce.web.requests import header, raw_path

MAX_PAGE = 1000  # items
MAX_HEADER = 255  # characters of a header that the API defines
T = TypeVar("T")
After = Annotated[  # a request line has 16 KiB, in which a character beyond ASCII takes up to 12 bytes
    str, Meta(pattern=r"^([ -~]{0,1600}|[^\x00]{0,1100})$", description="`next` of the page before")
]
Limit = Annotated[int, Meta(ge=1, le=MAX_PAGE, description="items of a page")]
NAME = f"({TAG.pattern})?"
Owner = Annotated[
    str,
    Meta(pattern=f"^{NAME}$", max_length=255, description="owner: another user, for roles that may; default: yourself"),
]
OwnerOrAll = Annotated[
    str,
    Meta(pattern=rf"^({NAME}|\*)$", max_length=255, description="owner: another user, or * for all; default: yourself"),
]


class OwnerQuery(Struct, frozen=True, forbid_unknown_fields=True):
    """Query of a request for one resource."""

    user: Owner = ""


class PageQuery(Struct, frozen=True, forbid_unknown_fields=True):
    """Query of every list."""

    limit: Limit = 100
    after: After = ""


class ListQuery(PageQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a list of resources that users own."""

    user: OwnerOrAll = ""


class AuditDetails(Struct):
    """Operation, owner of the resource, and names in the body of a request, for its entry in the audit log."""

    operation: str = ""
    owner: str = ""
    names: list[str] = []


class Call(NamedTuple):
    """A request that was routed and authenticated.

    `principal` is None, and `user` empty, where the route is public. `path` has the decoded variables of the path, and
    `parameters` those of the query; `token` is the credential of the Authorization header. A package upload is in
    `upload`, any other body in `content`.
    """

    user: str
    principal: Principal | None
    path: dict[str, str]
    token: str
    content: bytes
    upload: Upload | None
    parameters: dict[str, str]
    request: web.BaseRequest
    audit: AuditDetails

    @property
    def method(self) -> str:
        """The HTTP method."""
        return self.request.method

    @property
    def target(self) -> str:
        """Path and query as they were sent."""
        return self.request.raw_path

    @property
    def raw_path(self) -> str:
        """The path as it was sent."""
        return raw_path(self.request)

    def body(self, kind: type[T]) -> T:
        """Return the JSON body as a value of this type.

        Raises:
            InvalidRequest: It is malformed; `field` is the path of the value at fault.
        """
        found = decode_as(kind, self.content, "body", strict=True)
        self.audit.names = names_of(found)
        return found

    def header(self, name: str) -> str | None:
        """Return a header that the API defines, or None.

        Raises:
            InvalidRequest: It is empty or too long.
        """
        text = header(self.request, name)
        if text is not None and not 0 < len(text) <= MAX_HEADER:
            raise InvalidRequest(f"{name}: 1 to {MAX_HEADER} characters", field=name)
        return text

    def query(self, kind: type[T]) -> T:
        """Return the query as a value of this type.

        Raises:
            InvalidRequest: A parameter is unknown or malformed; `field` is its name.
        """
        try:
            found = msgspec.convert(self.parameters, kind, strict=False)
        except msgspec.ValidationError as error:
            reason, name = with_choices(error, kind)
            raise InvalidRequest(f"query{'.' if name else ''}{name}: {reason}", field=name) from None
        for name in self.parameters:
            if getattr(found, name) is None:  # msgspec takes the word null for it
                raise InvalidRequest(f"query.{name}: there is no null in a query; leave it out", field=name)
        return found


class Answer(NamedTuple):
    """Result of a handler.

    `body` is sent by its type: a path as the file there, bytes as they are (with the content type in `headers`), a
    stream or download until it ends, None as no body, anything else as JSON.
    """

    body: Struct | msgspec.Raw | list[Any] | Path | EventStream | Download | bytes | None = None
    status: int = 200
    headers: dict[str, str] = {}  # noqa: RUF012  # never changed


Handler = Callable[[Call], Awaitable[Answer]]
