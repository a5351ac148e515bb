"""The client of programs in an environment; its socket is tested in tests/endpoints/environment."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.api.knowledge_requests import PIECE, SOCKET, AddEntry, Found
from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.errors import NotFound, Unavailable
from tests.support.environment_knowledge import direct_knowledge
from tests.support.knowledge import CUP, new_entry


def test_contents_are_put_and_read_whole(tmp_path: Path) -> None:
    content = b"model" * (PIECE // 2)
    with direct_knowledge(tmp_path) as client:
        client.ask(AddEntry(new_entry()))
        for name, each in {"cup.stl": content, "empty.txt": b""}.items():
            client.put_file("object", "cup.blue", name, each)
        found = client.find("object", "cup.blue")
        assert found == Found("cup.blue", 3, ["cup.stl", "empty.txt"])
        assert client.read("object", found).decode() == CUP
        assert client.read("object", found, "cup.stl") == content
        assert client.read("object", found, "empty.txt") == b""
        with pytest.raises(NotFound):
            client.find("object", "cup")


def test_program_outside_of_an_environment_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(SOCKET, raising=False)
    with pytest.raises(Unavailable, match=SOCKET):
        EnvironmentKnowledge()
    monkeypatch.setenv(SOCKET, str(tmp_path / "none.sock"))
    with pytest.raises(Unavailable, match="knowledge socket"):
        EnvironmentKnowledge().search("object", "cup")
