"""Transcripts of a terminal in documents: their input is typed, and the output compared with them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from tests.support.e2e.consoles import TerminalProcess

PROMPT = re.compile(r"((?:Password|New password|Present password|Again)[^:]*: )(.*)")


class Step(NamedTuple):
    """A command of a transcript.

    Attributes:
        command: The command line.
        answers: Prompts and the answers to them.
        lines: Expected output, in which `…` matches anything.
    """

    command: str
    answers: list[tuple[str, str]]
    lines: list[str]

    @property
    def fails(self) -> bool:
        return any(line.startswith("rce: ") for line in self.lines)


def steps(document: Path, replaced: Mapping[str, str]) -> Iterator[Step]:
    """Yield the commands in code blocks of the language `console`."""
    text = document.read_text()
    for old, new in replaced.items():
        text = text.replace(old, new)
    for block in re.findall(r"^```console\n(.*?)^```", text, re.M | re.S):
        for part in re.split(r"^\$ ", block, flags=re.M)[1:]:
            first, *rest = part.rstrip("\n").split("\n")
            while rest and rest[0].startswith("> "):
                first += "\n" + rest.pop(0).removeprefix("> ")
            found = [match.groups() for line in rest if (match := PROMPT.fullmatch(line))]
            yield Step(
                first, [(prompt, answer) for prompt, answer in found], [x for x in rest if not PROMPT.fullmatch(x)]
            )


def play(shell: TerminalProcess, step: Step) -> None:
    """Type a command and compare its output."""
    shell.type(step.command + "\n")
    for prompt, answer in step.answers:
        shell.expect(re.escape(prompt))
        shell.type(answer + "\n")
    seen = shell.expect(r"<\d+>$")
    text, status = re.split(r"<(\d+)>$", seen)[:2]
    transcript = f"$ {step.command}\n{seen}"
    assert (status != "0") == step.fails, transcript
    expected = r"\s*".join(_pattern(line) for line in step.lines)
    assert re.fullmatch(rf"\s*{expected}\s*", text.replace("\r", ""), re.S), f"{transcript}\nexpected:\n" + "\n".join(
        step.lines
    )


def _pattern(line: str) -> str:
    """Return a pattern for a line, with any number of blanks, because the width of columns varies."""
    parts = (re.sub(r"(?:\\ )+", r" +", re.escape(part)) for part in line.split("…"))
    return ".*?".join(parts)
