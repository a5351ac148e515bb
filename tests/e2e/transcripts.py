"""Documents with transcripts of a terminal: what they show being typed is typed, and what they show must come."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from consoles import OnTerminal

ASKED = re.compile(r"((?:Password|New password|Present password|Again)[^:]*: )(.*)")


class Step(NamedTuple):
    """A command, the answers to what it asks, and the lines that it prints; `…` in them is anything."""

    command: str
    answers: list[tuple[str, str]]
    lines: list[str]

    @property
    def fails(self) -> bool:
        return any(line.startswith("rce: ") for line in self.lines)


def steps(document: Path, replaced: Mapping[str, str]) -> Iterator[Step]:
    """Those of the blocks marked `console`, in their order."""
    text = document.read_text()
    for old, new in replaced.items():
        text = text.replace(old, new)
    for block in re.findall(r"^```console\n(.*?)^```", text, re.M | re.S):
        for part in re.split(r"^\$ ", block, flags=re.M)[1:]:
            first, *rest = part.rstrip("\n").split("\n")
            while rest and rest[0].startswith("> "):
                first += "\n" + rest.pop(0).removeprefix("> ")
            found = [match.groups() for line in rest if (match := ASKED.fullmatch(line))]
            yield Step(first, [(asked, answer) for asked, answer in found], [x for x in rest if not ASKED.fullmatch(x)])


def play(shell: OnTerminal, step: Step) -> None:
    """Type it, and compare."""
    shell.type(step.command + "\n")
    for asked, answer in step.answers:
        shell.until(re.escape(asked))
        shell.type(answer + "\n")
    seen = shell.until(r"<\d+>$")
    text, status = re.split(r"<(\d+)>$", seen)[:2]
    told = f"$ {step.command}\n{seen}"
    assert (status != "0") == step.fails, told
    wanted = r"\s*".join(_pattern(line) for line in step.lines)
    assert re.fullmatch(rf"\s*{wanted}\s*", text.replace("\r", ""), re.S), f"{told}\nwanted:\n" + "\n".join(step.lines)


def _pattern(line: str) -> str:
    """Blanks in any number, for columns are as wide as what is in them."""
    parts = (re.sub(r"(?:\\ )+", r" +", re.escape(part)) for part in line.split("…"))
    return ".*?".join(parts)
