"""Fields of requests and responses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rce.errors import NotFound, Unauthorized
from tests.support.environment_knowledge import direct_knowledge
from tests.support.knowledge import CUP

Handlers = Mapping[str, Any]


@pytest.fixture
def handlers(tmp_path: Path) -> Iterator[Handlers]:
    from rce_knowledge.handlers import handlers
    from rce_knowledge.repository import Repository

    with direct_knowledge(tmp_path) as knowledge:
        yield handlers(Repository(knowledge), SimpleNamespace, SimpleNamespace, SimpleNamespace)


def request(**fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**({"apiKey": "key", "description": ""} | fields))


def file(name: str, content: bytes) -> SimpleNamespace:
    from rce_knowledge.handlers import bytes_of

    return SimpleNamespace(name=name, data=bytes_of(content))


def test_bytes_of_files_survive_as_signed_numbers() -> None:
    from rce_knowledge.handlers import bytes_of, content_of

    content = bytes(range(256))
    data = bytes_of(content)
    assert data[255] == -1
    assert content_of(SimpleNamespace(data=data)) == content


FILES: dict[str, Any] = {"files": []}
KINDS = [("ActionRecipe", "recipe", {}), ("Object", "object", FILES), ("Environment", "environment", FILES)]


@pytest.mark.parametrize(("noun", "field", "more"), KINDS)
def test_entries_of_each_kind(handlers: Handlers, noun: str, field: str, more: dict[str, Any]) -> None:
    handlers[f"Set{noun}"](request(cls="Cup", id="blue", **{field: CUP}, **more))
    got = handlers[f"Get{noun}"](request(**{f"{field}UID": "cup.blue"}))
    assert got == {field: CUP} | ({"filenames": [], "fileURLs": []} if more else {})
    found = handlers[f"Search{noun}s"](request(searchID="cup"))
    assert (found["uids"], found[f"{field}s"]) == (["cup.blue"], [CUP])
    handlers[f"Update{noun}"](request(uid="cup.blue", **{field: ""}))
    assert handlers[f"Get{noun}"](request(**{f"{field}UID": "cup.blue"}))[field] == ""
    assert '"rows"' in handlers[f"Query{noun}s"](request(query="SELECT S FROM {S} P {O}"))["result"]
    handlers[f"Del{noun}"](request(**{f"{field}UID": "cup.blue"}))
    with pytest.raises(NotFound):
        handlers[f"Get{noun}"](request(**{f"{field}UID": "cup.blue"}))


def test_files(handlers: Handlers) -> None:
    handlers["SetObject"](request(cls="cup", id="blue", object="", files=[file("a", b"\xff")]))
    found = handlers["SearchObjects"](request(searchID="cup"))
    assert found["filenames"] == [SimpleNamespace(list=["a"])]
    handlers["SetObjectBinaryFile"](request(objectUID="cup.blue", file=file("b", b"2")))
    handlers["UpdateObjectBinaryFile"](request(objectUID="cup.blue", file=file("a", b"\xfe")))
    got = handlers["GetObjectBinaryFile"](request(objectUID="cup.blue", filename="a"))
    assert (got["file"].name, list(got["file"].data)) == ("a", [-2])
    handlers["DelObjectBinaryFile"](request(objectUID="cup.blue", filename="a"))
    with pytest.raises(NotFound):
        handlers["GetObjectBinaryFile"](request(objectUID="cup.blue", filename="a"))


def test_map_of_an_environment(handlers: Handlers) -> None:
    files = [file("map.pgm", b"P5"), file("map.yaml", b"image: map.pgm\n")]
    handlers["SetEnvironment"](request(cls="room", id="one", environment="", files=files))
    got = handlers["Request2DMap"](request(envUID="room.one", srdl="", baseScannerLink="", targetMapName="kitchen"))
    assert (got["map"].name, got["meta"].name) == ("kitchen.pgm", "kitchen.yaml")
    assert bytes(got["meta"].data) == b"image: kitchen.pgm\n"


@pytest.mark.parametrize("name", ["SetObject", "UpdateObject", "DelObject", "SetObjectBinaryFile", "DelActionRecipe"])
def test_nothing_is_written_without_a_key(handlers: Handlers, name: str) -> None:
    with pytest.raises(Unauthorized):
        handlers[name](request(apiKey=""))
