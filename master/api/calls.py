"""A request, as its handler sees it, and what a handler answers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from msgspec import Meta, Struct
from twisted.web.server import Request

from master.api.streams import Stream
from master.audit import names_of
from master.rights import Principal
from rce.errors import InvalidRequest
from rce.messages import decode_as
from rce.names import TAG

MOST = 1000  # items of a page
LONGEST = 255  # characters of a header of ours
T = TypeVar("T")
After = Annotated[  # a line of HTTP has 16 KiB, in which a character beyond ASCII takes up to 12 bytes
    str, Meta(pattern=r"^([ -~]{0,1600}|[^\x00]{0,1100})$", description="`next` of the page before")
]
Limit = Annotated[int, Meta(ge=1, le=MOST, description="items of a page")]
NAME = f"({TAG.pattern})?"
Whose = Annotated[
    str,
    Meta(pattern=f"^{NAME}$", max_length=255, description="whose: another user, for those who may; empty: one's own"),
]
Everybodys = Annotated[
    str,
    Meta(pattern=rf"^({NAME}|\*)$", max_length=255, description="whose: another user's, or * for all"),
]


class One(Struct, frozen=True, forbid_unknown_fields=True):
    """What may be said in the query about a single thing."""

    user: Whose = ""


class Paging(Struct, frozen=True, forbid_unknown_fields=True):
    """What may be said in the query of each list."""

    limit: Limit = 100
    after: After = ""


class Listing(Paging, frozen=True, forbid_unknown_fields=True):
    """What may be said in the query of a list of users' things."""

    user: Everybodys = ""


class Trail(Struct):
    """What the audit log is to say of a request: the operation, whose thing it is about, and what the body names."""

    operation: str = ""
    owner: str = ""
    names: list[str] = []


class Call(NamedTuple):
    """`path` and `query` are decoded; without `principal` a token says it all. `content` is the file-like body."""

    user: str
    principal: Principal | None
    path: dict[str, str]
    token: str
    content: Any
    query: dict[str, str]
    request: Request
    trail: Trail

    def body(self, kind: type[T]) -> T:
        """The JSON body. InvalidRequest with the path of the field."""
        found = decode_as(kind, self.content.read(), "body")
        self.trail.names = names_of(found)
        return found

    def header(self, name: str) -> str | None:
        """InvalidRequest if it is empty or longer than any of ours."""
        text = self.request.getHeader(name)
        if text is not None and not 0 < len(text) <= LONGEST:
            raise InvalidRequest(f"{name}: 1 to {LONGEST} characters", field=name)
        return text

    def asked(self, kind: type[T]) -> T:
        """The query. InvalidRequest with the parameter's name."""
        try:
            found = msgspec.convert(self.query, kind, strict=False)
        except msgspec.ValidationError as error:
            reason, _, path = str(error).partition(" - at `$")
            name = path.rstrip("`").lstrip(".")
            raise InvalidRequest(f"query{'.' if name else ''}{name}: {reason}", field=name) from None
        for name in self.query:
            if getattr(found, name) is None:  # msgspec takes the word null for it
                raise InvalidRequest(f"query.{name}: there is no null in a query; leave it out", field=name)
        return found


class Answer(NamedTuple):
    """`body` goes out as JSON, a path as the file there, a stream as long as it goes on, bytes as they are, None not at
    all.
    """

    body: Struct | msgspec.Raw | list[Any] | Path | Stream | bytes | None = None
    status: int = 200
    headers: dict[str, str] = {}  # noqa: RUF012  # never changed


Handler = Callable[[Call], Awaitable[Answer]]
