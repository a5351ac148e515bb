"""Hollow processes: tokens of a fleet."""

from __future__ import annotations

from rce.bench.hollow_fleet import as_setting, make_tokens


def test_each_machine_has_a_token_for_its_task_set_and_its_endpoint() -> None:
    tokens = make_tokens(2)
    assert list(tokens) == ["m0", "e0", "m1", "e1"]
    assert len(set(tokens.values())) == 4
    words = as_setting(tokens).split(",")
    assert words[0] == f"container:m0:{tokens['m0']}"
    assert words[3] == f"robot:e1:{tokens['e1']}"
