"""What RoboEarth's clients do, with a knowledge service in this process."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from rce.errors import AlreadyExists, InvalidRequest, NotFound
from tests.support.environment_knowledge import direct_knowledge
from tests.support.knowledge import CUP, KITCHEN


@pytest.fixture
def repository(tmp_path: Path) -> Iterator[Any]:
    from rce_knowledge.repository import Repository

    with direct_knowledge(tmp_path) as knowledge:
        yield Repository(knowledge)


def test_entry_comes_with_its_files(repository: Any) -> None:
    repository.set("object", "Cup", "blue", "a cup", CUP, {"cup.stl": b"model"})
    item = repository.get("object", "cup.blue")
    url = "/knowledge-service/entries/object/cup.blue/files/cup.stl"
    assert (item.uid, item.text, item.files, item.urls) == ("cup.blue", CUP, ["cup.stl"], [url])
    assert repository.search("object", "cup") == [item]
    with pytest.raises(AlreadyExists):
        repository.set("object", "Cup", "blue", "", "", {})
    query = f"SELECT S FROM {{S}} k:height {{H}} USING NAMESPACE k = <{KITCHEN}>"
    assert json.loads(repository.query(query)) == {"variables": ["S"], "rows": [[f"<{KITCHEN}cup1>"]]}
    repository.update("object", "cup.blue", "empty", "")
    assert repository.get("object", "cup.blue").text == ""
    repository.remove("object", "cup.blue")
    assert repository.search("object", "cup") == []


def test_entry_whose_file_is_refused_is_not_added(repository: Any) -> None:
    with pytest.raises(InvalidRequest):
        repository.set("object", "cup", "blue", "", CUP, {"good.txt": b"", "bad/name": b""})
    with pytest.raises(NotFound):
        repository.get("object", "cup.blue")


def test_files_are_added_replaced_and_removed(repository: Any) -> None:
    repository.set("object", "cup", "blue", "", "", {"a.txt": b"1"})
    with pytest.raises(AlreadyExists, match="update it"):
        repository.add_file("object", "cup.blue", "a.txt", b"2")
    with pytest.raises(NotFound):
        repository.replace_file("object", "cup.blue", "b.txt", b"2")
    repository.add_file("object", "cup.blue", "b.txt", b"2")
    repository.replace_file("object", "cup.blue", "a.txt", b"3")
    assert [repository.file("object", "cup.blue", name) for name in ("a.txt", "b.txt")] == [b"3", b"2"]
    repository.remove_file("object", "cup.blue", "a.txt")
    with pytest.raises(NotFound, match=r"no file 'a\.txt'"):
        repository.file("object", "cup.blue", "a.txt")


def test_map_has_the_name_that_the_client_chose(repository: Any) -> None:
    meta = b"image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n"
    repository.set("environment", "room", "one", "", "", {"map.pgm": b"P5", "map.yaml": meta})
    files = repository.map("room.one", "kitchen")
    assert files["kitchen.pgm"] == b"P5"
    described = yaml.safe_load(files["kitchen.yaml"])
    assert described == {"image": "kitchen.pgm", "resolution": 0.05, "origin": [0, 0, 0]}
    repository.set("environment", "room", "two", "", "", {"map.pgm": b"P5", "map.yaml": b"[1]"})
    with pytest.raises(InvalidRequest, match="describes no map"):
        repository.map("room.two", "kitchen")
    repository.set("environment", "room", "three", "", "", {"map.pgm": b"P5"})
    with pytest.raises(NotFound):
        repository.map("room.three", "kitchen")
