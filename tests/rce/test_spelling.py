"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib

import pytest

from rce.spelling import counted, did_you_mean, unknown, with_article


@pytest.mark.parametrize(
    ("word", "suggestion"),
    [("memroy", "did you mean memory?"), ("LASERSCAN", "did you mean LaserScan?"), ("wings", ""), ("", "")],
)
def test_nearest_name_is_suggested(word: str, suggestion: str) -> None:
    assert did_you_mean(word, ["memory", "LaserScan", "cpu"]) == suggestion


def test_word_longer_than_any_name_is_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """A word of 1 MB took a third of a second."""
    monkeypatch.setattr(difflib, "SequenceMatcher", None)
    assert did_you_mean("m" * 81, ["memory"]) == ""


def test_name_of_the_same_length_is_nearer() -> None:
    assert did_you_mean("evn", ["events", "env"]) == "did you mean env?"


@pytest.mark.parametrize(("noun", "text"), [("Publisher", "a Publisher"), ("ActionClient", "an ActionClient")])
def test_noun_has_its_article(noun: str, text: str) -> None:
    assert with_article(noun) == text


@pytest.mark.parametrize(("number", "text"), [(0, "0 files"), (1, "1 file"), (2, "2 files")])
def test_things_are_counted(number: int, text: str) -> None:
    assert counted(number, "file") == text


def test_unknown_name_is_reported_with_the_nearest() -> None:
    assert unknown("environment", "brian", ["brain"]) == "there is no environment 'brian': did you mean brain?"
    assert unknown("environment", "x" * 100, ["brain"]) == f"there is no environment '{'x' * 80}'"
