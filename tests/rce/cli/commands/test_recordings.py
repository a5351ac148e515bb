"""`recorder` and the commands of `bag` for recordings that the platform keeps."""

from __future__ import annotations

from pathlib import Path

import pytest

from containers.recordings.store import MAGIC
from rce.cli.execute import SUCCESS
from rce.errors import Unavailable
from tests.support.console import login, rce
from tests.support.master.recordings import keep_recordings, recorded
from tests.support.master.served import Served

CONTENT = MAGIC + b"content" + MAGIC


async def test_recorder_is_added_listed_and_removed(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served.url, "ann", "home")
    await rce("env", "create", "brain")
    assert await rce("recorder", "add", "brain", "box", "/scan", "--max-size", "2") == SUCCESS
    capsys.readouterr()
    await rce("recorder", "list", "brain")
    assert capsys.readouterr().out.splitlines()[1].split() == ["box", "recording", "/scan", "1.907", "MiB", "-"]
    assert await rce("recorder", "remove", "brain", "box") == SUCCESS
    await rce("recorder", "list", "brain", "--json")
    assert capsys.readouterr().out == "[]\n"


async def test_recordings_are_listed_downloaded_uploaded_and_removed(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store = keep_recordings(served, "m1", tmp_path / "m1")
    await served.process("container", "m2", capacity=1)
    served.peers["m2"].refuse |= dict.fromkeys(served.peers["m1"].answers, Unavailable("busy"))
    await login(served.url, "ann", "home")
    name = f"m1/{recorded(store, CONTENT)}"
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    await rce("bag", "list", "brain")
    printed = capsys.readouterr()
    assert name in printed.out
    assert printed.err == "machine m2 is away: its recordings are missing here\n"
    assert await rce("bag", "get", name) == SUCCESS
    file = tmp_path / store.path(name.partition("/")[2]).name
    assert file.read_bytes() == CONTENT
    capsys.readouterr()
    assert await rce("bag", "upload", str(file)) == SUCCESS
    uploaded = capsys.readouterr().out.strip()
    assert {f"m1/{each.id}" for each in store.of("ann")} == {name, uploaded}
    assert await rce("bag", "remove", name, uploaded) == SUCCESS
    assert store.of("ann") == []
