"""Record of commands and faults."""

from __future__ import annotations

from pathlib import Path

import msgspec

from rce.bench.chaos.history import Entry, History


def test_each_entry_is_in_the_file_at_once(tmp_path: Path) -> None:
    history = History(tmp_path / "history.jsonl")
    history.add("nemesis", "master killed")
    history.add("r0", "add environment e", "acknowledged")
    lines = (tmp_path / "history.jsonl").read_bytes().splitlines()
    history.close()
    assert [msgspec.json.decode(line, type=Entry) for line in lines] == history.entries
    assert [(each.who, each.outcome) for each in history.entries] == [("nemesis", "begins"), ("r0", "acknowledged")]


def test_tail_has_the_last_entries() -> None:
    history = History()
    for number in range(5):
        history.add("r0", number, "acknowledged")
    assert [line.split()[2] for line in history.tail(2).splitlines()] == ["3:", "4:"]
