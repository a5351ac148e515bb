"""The mutator: cases are repeatable, differ, and are always bytes."""

from __future__ import annotations

import json

from tests.support.fuzz.calls import encode, examples, pages
from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.robot_frames import FrameGrammar, templates


def test_seed_repeats_its_cases() -> None:
    def cases(seed: str) -> list[bytes]:
        grammar = FrameGrammar(mutator := Mutator(seed), "r", parts=True, deflate=True)
        return [grammar.message() + grammar.stream() + mutator.json(templates("r")[0]) for _ in range(200)]

    assert cases("1") == cases("1") != cases("2")


def test_template_is_not_changed() -> None:
    template = templates("r")
    mutator = Mutator("1")
    changed = [mutator.structure(template) for _ in range(200)]
    assert template == templates("r")
    assert sum(json.dumps(each) != json.dumps(template) for each in changed) > 190


def test_each_call_has_an_example_that_can_be_sent() -> None:
    known = examples()
    assert {"Execute", "Login", "StopNode", "Sync"} <= known.keys()
    mutator = Mutator("1")
    for value in known.values():
        assert all(encode([b"call", *pages("ReadLog", mutator.structure(value))]) for _ in range(20))
