"""Words of messages: the nearest known name where an unknown one was given, articles and plurals."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MAX_WORD = 80  # characters of a misspelt name: the names of the platform are shorter


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return `did you mean NAME?` with the known name nearest to a word; empty if none is near.

    Of several that are as near, it is the one of the most similar length.
    """
    if len(word) > MAX_WORD:
        return ""
    names = {name.casefold(): name for name in known}
    matcher = difflib.SequenceMatcher(b=word.casefold())

    def nearness(name: str) -> tuple[float, int]:
        matcher.set_seq1(name)
        return matcher.ratio(), -abs(len(name) - len(word))

    near = difflib.get_close_matches(word.casefold(), names)
    return f"did you mean {names[max(near, key=nearness)]}?" if near else ""


def with_article(noun: str) -> str:
    """Return a noun with its article: `a Publisher`, `an ActionClient`."""
    return f"{'an' if noun[:1].casefold() in set('aeiou') else 'a'} {noun}"


def counted(number: int, noun: str) -> str:
    """Return a number of things: `1 file`, `2 files`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def unknown(what: str, name: str, known: Iterable[str], most: int = MAX_WORD) -> str:
    """Return the message for an unknown name: `there is no environment 'brian': did you mean brain?`."""
    hint = did_you_mean(name[:most], known)
    return f"there is no {what} {name[:most]!r}" + (f": {hint}" if hint else "")


def tags(names: Iterable[str]) -> list[str]:
    """Return the last parts of keys such as `user/environment/node`."""
    return [name.rpartition("/")[2] for name in names]
