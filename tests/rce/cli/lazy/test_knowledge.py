"""`rce knowledge …` with a service in this process."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rce.cli.command import parser
from rce.cli.lazy import knowledge
from rce.cli.session import ConsoleSession
from rce.cli.table import COMMANDS
from rce.errors import InvalidRequest, NotFound, TimedOut, Unavailable
from rce.knowledge.changes import Subscription
from rce.knowledge.records import Reader
from tests.support.knowledge import BED, CUP, Service


@pytest.fixture
async def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Service]:
    service = Service(tmp_path / "knowledge")
    await service.start()
    monkeypatch.setenv("RCE_URL", service.root)
    monkeypatch.setenv("RCE_KEY", "rce_ann")
    monkeypatch.setenv("RCE_USER", "ann")
    yield service
    await service.stop()


async def run(*words: str) -> None:
    """Run a command."""
    args = parser(COMMANDS[f"knowledge {words[0]}"]).parse_args(words[1:])
    function = getattr(knowledge, {"import": "restore"}.get(words[0], words[0]))
    await asyncio.to_thread(function, ConsoleSession.__new__(ConsoleSession), args)


async def test_entry_is_added_changed_searched_and_removed(
    service: Service, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = tmp_path / "cup.ttl"
    text.write_text(CUP)
    await run("add", "object", "cup.blue", str(text), "--share", "bob", "--json")
    assert json.loads(capsys.readouterr().out)["version"] == 1
    text.write_text(BED)
    await run("add", "object", "cup.blue", str(text), "--public", "--file", str(text))
    assert capsys.readouterr().out.splitlines()[-1].split() == ["files", "cup.ttl"]
    await run("search", "cup", "--class", "Bed", "--json")
    entry = json.loads(capsys.readouterr().out.partition("[")[2].rpartition("]")[0])
    assert (entry["version"], entry["public"], entry["shared"]) == (3, True, ["bob"])
    await run("history", "object", "cup.blue")
    assert "cup.ttl" in capsys.readouterr().out
    await run("get", "object", "cup.blue", "--version", "1")
    assert capsys.readouterr().out == CUP
    await run("get", "object", "cup.blue", "--out", str(tmp_path / "out"))
    assert (tmp_path / "out" / "cup.ttl").read_text() == (tmp_path / "out" / "cup.blue.owl").read_text() == BED
    await run("remove", "object", "cup.blue")
    with pytest.raises(NotFound):
        await run("history", "object", "cup.blue")


async def test_environment_with_a_map(service: Service, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("map.pgm", "map.yaml", "notes.log"):
        (tmp_path / name).write_bytes(b"x")
    await run("add", "environment", "office.one", "--map", str(tmp_path), "--place", "47.4", "8.5", "--json")
    entry = json.loads(capsys.readouterr().out)
    assert [file["name"] for file in entry["files"]] == ["map.pgm", "map.yaml"]
    await run("search", "--near", "47.4", "8.5")
    assert "office.one" in capsys.readouterr().out
    with pytest.raises(NotFound, match="no files of a map"):
        await run("add", "environment", "office.two", "--map", str(tmp_path / "nothing"))
    with pytest.raises(NotFound, match="no such file"):
        await run("add", "environment", "office.two", "--file", str(tmp_path / "nothing"))


async def test_queries(service: Service, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    await service.add()
    await run("query", "ASK { ?s a ?c }")
    assert capsys.readouterr().out == "yes\n"
    (tmp_path / "q").write_text("SELECT S FROM {S} rdf:type {C}")
    await run("query", f"@{tmp_path / 'q'}", "--serql")
    assert "cup1" in capsys.readouterr().out
    await run("query", "SELECT ?s { ?s a ?c }", "--json")
    assert json.loads(capsys.readouterr().out)["variables"] == ["s"]
    (tmp_path / "q").write_bytes(b"\xff")
    with pytest.raises(InvalidRequest, match="UTF-8"):
        await run("query", f"@{tmp_path / 'q'}")


async def test_archive(service: Service, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    await service.add()
    await run("export", str(tmp_path / "all.zip"))
    await run("import", str(tmp_path / "all.zip"))
    assert capsys.readouterr().out.splitlines()[-1] == "0 added, 1 already there"


async def test_subscription_resumes_where_it_broke(
    service: Service, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    await service.add()
    await service.add(id="red")
    asked: list[int | None] = []

    def changes(self: object, *, after: int | None, **_: object) -> object:
        asked.append(after)
        if len(asked) > 3:
            raise KeyboardInterrupt
        yield from (each for each in known if each.number > (after or 0))
        raise TimedOut("nothing came") if len(asked) == 1 else Unavailable("the connection was cut off")

    known = (await service.service.repository.changes(Reader("ann"), Subscription(), 0))[0]
    monkeypatch.setattr(knowledge.KnowledgeClient, "changes", changes)
    monkeypatch.setattr(knowledge, "RETRY_DELAY", 0)
    with pytest.raises(KeyboardInterrupt):
        knowledge.subscribe(
            ConsoleSession.__new__(ConsoleSession), parser(COMMANDS["knowledge subscribe"]).parse_args([])
        )
    assert asked == [None, 2, 2, 2]
    printed = capsys.readouterr()
    assert [json.loads(line)["uid"] for line in printed.out.splitlines()] == ["cup.blue", "cup.red"]
    assert printed.err.count("opened anew") == 2, "silence is usual"
