"""The table of commands, and the help that lists them."""

from __future__ import annotations

import re
import shlex

import pytest

from rce.cli import table
from rce.cli.command import Command, Lazy, Program, Section, parser
from rce.process import programs

COMMANDS = list(table.COMMANDS.values())


def name_of(command: Command) -> str:
    return command.name


@pytest.mark.parametrize("command", COMMANDS, ids=name_of)
def test_examples_are_valid_command_lines(command: Command) -> None:
    for example in command.examples:
        found, arguments = table.find_command(shlex.split(re.split("[<>]", example)[0]))
        assert found is command
        parser(command).parse_args(arguments)


@pytest.mark.parametrize("entry", [*COMMANDS, *table.PROGRAMS.values()], ids=lambda entry: entry.name)
def test_lazy_function_exists(entry: Command | Program) -> None:
    function = getattr(entry.run, "work", entry.run)
    if isinstance(function, Lazy):
        assert callable(function.load())


def test_every_program_is_installed() -> None:
    listed = set(table.PROGRAMS) - {"up", "complete"}
    assert listed <= set(programs.installed_programs())


def test_names_in_the_table_are_unique() -> None:
    commands = [entry.name for entry in table.TABLE if isinstance(entry, Command)]
    assert len(commands) == len(table.COMMANDS)


@pytest.mark.parametrize(
    ("line", "is_program"),
    [
        ("up --dev", True),
        ("robot", True),
        ("robot --master=tcp:a:1", True),
        ("robot list", False),
        ("container --help", True),
        ("container start -n c1", False),
        ("master", True),
        ("user --data-dir=/var/lib/rce/master add ada", True),
        ("user --database sqlite:// list", True),
        ("user add ada", False),
        ("machine --config=/etc/rce/master.toml list", True),
        ("machine list", False),
        ("env list", False),
    ],
)
def test_arguments_decide_between_program_and_command_of_one_name(line: str, is_program: bool) -> None:
    assert (table.find_program(line.split()) is not None) is is_program


def test_overview_lists_every_visible_entry() -> None:
    text = table.overview()
    for entry in table.TABLE:
        visible = isinstance(entry, Command | Program) and entry.section is not Section.HIDDEN
        assert not visible or re.search(rf"^  {entry.name.split()[0]} ", text, re.MULTILINE), entry.name


@pytest.mark.parametrize("word", sorted({name.split()[0] for name in table.COMMANDS}))
def test_list_of_a_groups_commands_fits_80_columns(word: str) -> None:
    assert max(map(len, table.group_help(word, "rce").splitlines())) <= 80


def test_overview_fits_80_columns() -> None:
    assert max(map(len, table.overview().splitlines())) <= 80


def test_console_overview_lists_only_commands_of_the_console() -> None:
    words = set(re.findall(r"^  (\S+)", table.console_overview(), re.MULTILINE))
    assert words == {command.name.split()[0] for command in COMMANDS if command.in_console}
    assert not words & {"map", "bench", "package", "run", "up", "complete"}
