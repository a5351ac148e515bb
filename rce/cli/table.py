"""The table of commands and programs, and the help that lists them."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from rce.cli.command import LINE_WIDTH, Command, Group, Program, Section
from rce.cli.commands import (
    accounts,
    bags,
    bench,
    data,
    environments,
    knowledge,
    login,
    machines,
    maps,
    maps3d,
    packages,
    planning,
    programs,
    recordings,
    robots,
    secrets,
    services,
    tracing,
)

TABLE: tuple[Command | Program | Group, ...] = (
    programs.UP,
    *maps.COMMANDS,
    *maps3d.COMMANDS,
    *planning.COMMANDS,
    knowledge.GROUP,
    *knowledge.COMMANDS,
    programs.RUN,
    packages.GROUP,
    *packages.COMMANDS,
    services.GROUP,
    *services.COMMANDS,
    bench.GROUP,
    *bench.COMMANDS,
    programs.BRIDGE,
    programs.IMAGE,
    *login.COMMANDS,
    *environments.COMMANDS,
    *robots.COMMANDS,
    *data.COMMANDS,
    bags.GROUP,
    *bags.COMMANDS,
    recordings.GROUP,
    *recordings.COMMANDS,
    *tracing.COMMANDS,
    *machines.COMMANDS,
    *accounts.COMMANDS,
    *secrets.COMMANDS,
    *programs.SERVERS,
    *programs.ON_MASTER_FILES,
    programs.COMPLETE,
)
"""All of `rce`, in the order of `rce --help`."""

COMMANDS = {entry.name: entry for entry in TABLE if isinstance(entry, Command)}
PROGRAMS = {entry.name: entry for entry in TABLE if isinstance(entry, Program)}
GROUPS = {entry.name: entry for entry in TABLE if isinstance(entry, Group)}


def find_program(words: Sequence[str]) -> Program | None:
    """Return the program that a command line runs, or None if it is a command's."""
    program = PROGRAMS.get(words[0]) if words else None
    return program if program is not None and program.selected_by(words[1:]) else None


def find_command(words: Sequence[str], in_console: bool = False) -> tuple[Command | None, list[str]]:
    """Return the command that a line begins with, and its arguments; None and all words if there is none."""
    for length in (2, 1):
        command = COMMANDS.get(" ".join(words[:length]))
        if command is not None and len(words) >= length and (command.in_console or not in_console):
            return command, list(words[length:])
    return None, list(words)


def commands_of(word: str, in_console: bool = False) -> list[Command]:
    """Return the commands whose first word is this."""
    return [
        command
        for name, command in COMMANDS.items()
        if name.partition(" ")[0] == word and (command.in_console or not in_console)
    ]


def first_words(in_console: bool = False) -> list[str]:
    """Return the first words of all commands, and of the programs unless in the console, sorted."""
    words = {name.partition(" ")[0] for name, command in COMMANDS.items() if command.in_console or not in_console}
    if not in_console:
        words |= {program.name for program in PROGRAMS.values() if program.section is not Section.HIDDEN}
    return sorted(words)


def second_words(word: str, in_console: bool = False) -> dict[str, str]:
    """Return the second words that may follow a first one, with the help of each."""
    words = ((command.name.partition(" ")[2], command.help) for command in commands_of(word, in_console))
    return {second: text for second, text in words if second}


def summary(word: str, in_console: bool = False) -> str:
    """Return the line of help of a first word: that of its group or only command, else its second words."""
    if word in GROUPS:
        return GROUPS[word].help
    if word in COMMANDS:
        return COMMANDS[word].help
    commands = commands_of(word, in_console)
    if len(commands) == 1:
        return commands[0].help
    return ", ".join(second_words(word, in_console)) or PROGRAMS[word].help


def console_overview() -> str:
    """Return the commands that the console has, a line for each first word."""
    return _listing({word: summary(word, in_console=True) for word in first_words(in_console=True)})


def overview() -> str:
    """Return the text of `rce --help`: the whole table."""
    local = dict.fromkeys(
        entry.name.partition(" ")[0]
        for entry in TABLE
        if not isinstance(entry, Group) and entry.section is Section.LOCAL
    )
    return "\n".join(
        [
            "usage: rce COMMAND …; `rce COMMAND --help` explains a command",
            *("", "To begin, run a platform here with `rce up --dev`; see README.md and", "docs/console.md.", ""),
            _listing({word: summary(word) for word in local}),
            *("", "at a platform (`rce login URL` selects it), also in `rce console`:"),
            console_overview(),
            *("", "the parts of a platform, one by one:"),
            _listing(_programs(Section.SERVER), width=19),
            *("", "on the files of a Master of this machine, whether it runs or not:"),
            _listing(_programs(Section.MASTER_FILES), width=20),
        ]
    )


def _programs(section: Section) -> dict[str, str]:
    return {program.usage or program.name: program.help for program in PROGRAMS.values() if program.section is section}


def _listing(lines: Mapping[str, str], width: int = 13) -> str:
    return "\n".join(_wrapped(f"  {name:{width}}", text) for name, text in lines.items())


def _wrapped(start: str, text: str) -> str:
    """Return a start and a text beside it, in lines of LINE_WIDTH characters."""
    return textwrap.fill(text, LINE_WIDTH, initial_indent=start, subsequent_indent=" " * len(start))


def group_help(word: str, prog: str, in_console: bool = False) -> str:
    """Return the help of a first word that has several commands: a line for each."""
    start = f"{prog} {word}".strip()
    commands = commands_of(word, in_console)
    width = max(len(command.name) for command in commands)
    lines = [_wrapped("usage: ", f"{start} COMMAND …; `{start} COMMAND --help` explains a command"), ""]
    if word in GROUPS:
        lines += [*filter(None, [GROUPS[word].help, textwrap.fill(GROUPS[word].description, LINE_WIDTH)]), ""]
    return "\n".join(lines + [_wrapped(f"  {command.name:{width}}  ", command.help) for command in commands])
