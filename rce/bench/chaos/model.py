"""Model of the platform: the facts that follow from the acknowledged commands."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

Fact = tuple[str, ...]
"""One of

- `("robot", ROBOT)`
- `("environment", TAG)`
- `("node", ENVIRONMENT, TAG)`
- `("parameter", ENVIRONMENT, NAME, VALUE)`
- `("interface", OWNER, TAG)`
- `("connection", OWNER/TAG, OWNER/TAG)`, the two ends in alphabetical order
- `("upload", NAME)`
"""


class Step(NamedTuple):
    """A command that adds or removes a fact."""

    verb: Literal["add", "remove"]
    fact: Fact

    def __str__(self) -> str:
        return f"{self.verb} {' '.join(self.fact)}"


def connection(one: str, other: str) -> Fact:
    """Return the fact that two interfaces are connected."""
    return ("connection", *sorted((one, other)))


class Model:
    """The facts at present.

    Attributes:
        facts: All facts.
        acknowledged: Number of acknowledged commands.
    """

    def __init__(self, facts: Iterable[Fact] = ()) -> None:
        """Begin with facts that were found."""
        self.facts = set(facts)
        self.acknowledged = 0

    def acknowledge(self, step: Step) -> None:
        """Take in a command that was acknowledged."""
        self.acknowledged += 1
        if step.verb == "add":
            self.facts = {each for each in self.facts if not _replaces(step.fact, each)} | {step.fact}
        else:
            self.facts = {each for each in self.facts if each != step.fact and not _depends(each, step.fact)}

    def of_kind(self, kind: str, *first: str) -> list[Fact]:
        """Return the facts of a kind whose first words are these, sorted."""
        return sorted(each for each in self.facts if each[: len(first) + 1] == (kind, *first))


def _replaces(new: Fact, old: Fact) -> bool:
    """Return whether a fact replaces another: a parameter has one value."""
    return new[0] == "parameter" and new[:3] == old[:3]


def _depends(fact: Fact, on: Fact) -> bool:
    """Return whether a fact ends with another."""
    if on[0] == "environment":
        ends = fact[1:] if fact[0] == "connection" else ()
        inside = fact[0] in ("node", "parameter", "interface") and fact[1] == on[1]
        return inside or any(end.partition("/")[0] == on[1] for end in ends)
    return on[0] == "interface" and fact[0] == "connection" and "/".join(on[1:]) in fact[1:]
