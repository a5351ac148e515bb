"""Queries, headers and bodies of requests are checked before a handler works with them."""

from __future__ import annotations

from typing import Annotated, Any
from urllib.parse import quote

import pytest
from msgspec import Meta, Struct

from master.api.request import MAX_HEADER, MAX_PAGE, Call, ListQuery, OwnerQuery, PageQuery
from rce.errors import InvalidRequest
from rce.protocol import messages as m
from tests.support.master.calls import make_call
from tests.support.master.served import Served


class Query(Struct, frozen=True, forbid_unknown_fields=True):
    """A parameter of each kind."""

    text: str = ""
    number: Annotated[int, Meta(ge=1, le=10)] = 5
    follow: bool = False
    since: float | None = None


class Body(Struct, frozen=True, forbid_unknown_fields=True):
    """A body with names that the audit log notes."""

    containerTag: str
    name: str = ""
    sizes: list[int] = []


def queried(**parameters: str) -> Call:
    return make_call(None, parameters=parameters)


def test_query_is_converted_to_its_types() -> None:
    assert queried().query(Query) == Query()
    found = queried(text="7", number="7", follow="true", since="1.5").query(Query)
    assert found == Query("7", 7, True, 1.5)


@pytest.mark.parametrize(
    ("parameters", "field"),
    [
        ({"number": "0"}, "number"),
        ({"number": "11"}, "number"),
        ({"number": "x"}, "number"),
        ({"follow": "maybe"}, "follow"),
        ({"since": "soon"}, "since"),
        ({"since": "null"}, "since"),
        ({"other": "1"}, ""),
    ],
)
def test_wrong_parameter_is_named(parameters: dict[str, str], field: str) -> None:
    with pytest.raises(InvalidRequest, match=f"query.{field}" if field else "query: .*other") as raised:
        queried(**parameters).query(Query)
    assert raised.value.field == field


def test_word_null_is_a_text_where_text_is_wanted() -> None:
    assert queried(text="null").query(Query).text == "null"


@pytest.mark.parametrize(
    ("kind", "parameters", "good"),
    [
        (PageQuery, {"limit": "1"}, True),
        (PageQuery, {"limit": str(MAX_PAGE)}, True),
        (PageQuery, {"limit": "0"}, False),
        (PageQuery, {"limit": str(MAX_PAGE + 1)}, False),
        (PageQuery, {"after": "a" * 1600}, True),
        (PageQuery, {"after": "a" * 1601}, False),
        (PageQuery, {"after": "ü" * 1100}, True),
        (PageQuery, {"after": "ü" * 1101}, False),
        (PageQuery, {"after": "a\0"}, False),
        (OwnerQuery, {"user": "ann"}, True),
        (OwnerQuery, {"user": ""}, True),
        (OwnerQuery, {"user": "*"}, False),
        (OwnerQuery, {"user": "a/b"}, False),
        (ListQuery, {"user": "*"}, True),
        (ListQuery, {"user": "**"}, False),
    ],
)
def test_common_parameters_are_bounded(kind: type[Any], parameters: dict[str, str], good: bool) -> None:
    if good:
        (value,) = parameters.values()
        found = queried(**parameters).query(kind)
        assert str(getattr(found, next(iter(parameters)))) == value
        return
    with pytest.raises(InvalidRequest) as raised:
        queried(**parameters).query(kind)
    assert raised.value.field == next(iter(parameters))


def test_body_is_decoded_and_its_names_are_noted() -> None:
    call = make_call(None, content=b'{"containerTag":"brain","name":"n","sizes":[1]}')
    assert call.body(Body) == Body("brain", "n", [1])
    assert call.audit.names == ["brain", "n"]


@pytest.mark.parametrize(
    ("content", "field"),
    [
        (b"", ""),
        (b"{", ""),
        (b"[]", ""),
        (b"{}", ""),
        (b'{"containerTag":1}', "containerTag"),
        (b'{"containerTag":"a","sizes":[1,"x"]}', "sizes[1]"),
        (b'{"containerTag":"a","more":1}', "more"),
        (b'{"containerTag":"\xff"}', ""),
    ],
)
def test_wrong_body_names_the_field(content: bytes, field: str) -> None:
    call = make_call(None, content=content)
    with pytest.raises(InvalidRequest, match="body") as raised:
        call.body(Body)
    assert raised.value.field == field
    assert call.audit.names == []


def test_header_is_returned_or_missing() -> None:
    call = make_call(None, headers={"Last-Event-ID": "7"})
    assert call.header("last-event-id") == "7"
    assert call.header("Idempotency-Key") is None


@pytest.mark.parametrize(("length", "good"), [(0, False), (1, True), (MAX_HEADER, True), (MAX_HEADER + 1, False)])
def test_length_of_headers_is_limited(length: int, good: bool) -> None:
    call = make_call(None, headers={"X": "a" * length})
    if good:
        assert call.header("X") == "a" * length
    else:
        with pytest.raises(InvalidRequest) as raised:
            call.header("X")
        assert raised.value.field == "X"


def test_path_and_target_are_as_they_were_sent() -> None:
    call = make_call(None, "POST", "/a%2Fb?c=%20d")
    assert (call.method, call.raw_path, call.target) == ("POST", "/a%2Fb", "/a%2Fb?c=%20d")


# --- over HTTP --------------------------------------------------------------------------------------------------------


async def test_next_page_after_the_longest_names(served: Served) -> None:
    pair = quote(" ".join(["u" * 255 + "/" + "t" * 255 + "/" + "t" * 255] * 2))
    assert (await served.ask("GET", f"/connections?after={pair}")).status == 200
    assert (await served.ask("GET", f"/connections?after={quote('ü' * 1100)}")).status == 200
    assert (await served.ask("GET", f"/connections?after={quote('ü' * 1101)}")).body["field"] == "after"


async def test_last_event_id_that_is_too_long_is_refused(served: Served) -> None:
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    for path in ("/events", "/environments/brain/log"):
        answer = await served.ask("GET", path, "ann", **{"Last-Event-ID": "1" * (MAX_HEADER + 1)})
        assert (answer.status, answer.body["field"]) == (400, "Last-Event-ID")
