"""All commands of the console in one table."""

from __future__ import annotations

from collections.abc import Sequence

from rce.console import accounts, data, environments, machines, robots, signing, tracing
from rce.console.command import Command

COMMANDS: dict[str, Command] = {
    command.name: command
    for family in (signing, environments, robots, data, tracing, machines, accounts)
    for command in family.COMMANDS
}
WORDS = sorted({name.partition(" ")[0] for name in COMMANDS})
"""The first words of commands."""


def find(words: Sequence[str]) -> tuple[Command | None, list[str]]:
    """The command that a line begins with, and its arguments."""
    for length in (2, 1):
        command = COMMANDS.get(" ".join(words[:length]))
        if command is not None and len(words) >= length:
            return command, list(words[length:])
    return None, list(words)


def below(word: str) -> list[Command]:
    """The commands whose first word is this."""
    return [command for name, command in COMMANDS.items() if name.partition(" ")[0] == word]


def overview(prefix: str = "") -> str:
    """The commands with what they do, a line each; those of one first word together."""
    lines = []
    for word in WORDS:
        found = below(word)
        if len(found) == 1:
            lines.append(f"  {prefix}{word:12} {found[0].help}")
        else:
            lines.append(f"  {prefix}{word:12} {', '.join(command.name.partition(' ')[2] for command in found)}")
    return "\n".join(lines)


def usage_of(word: str, prog: str) -> str:
    """The commands that begin with this word."""
    begin = f"{prog} {word}".strip()
    lines = [f"{begin} …; {begin} COMMAND --help tells more", ""]
    width = max(len(command.name) for command in below(word))
    return "\n".join(lines + [f"  {command.name:{width}}  {command.help}" for command in below(word)])
