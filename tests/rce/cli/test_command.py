"""Entries of the table of commands, and parsers of commands."""

from __future__ import annotations

import argparse
import posixpath

import pytest

from rce.cli import table
from rce.cli.arguments import argument
from rce.cli.command import Command, Lazy, Program, Section, UsageError, parser
from rce.cli.session import ConsoleSession

COMMANDS = list(table.COMMANDS.values())


def name_of(command: Command) -> str:
    return command.name


def do_nothing(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Stand in for the function of a command."""


@pytest.mark.parametrize("command", COMMANDS, ids=name_of)
def test_help_of_a_command_is_a_sentence(command: Command) -> None:
    text = parser(command).format_help()
    assert text.startswith(f"usage: rce {command.name} ")
    assert command.help in " ".join(text.split())
    assert command.help.endswith(".")


@pytest.mark.parametrize("command", COMMANDS, ids=name_of)
def test_description_of_a_command_fits_80_columns(command: Command) -> None:
    description = parser(command).description
    assert description is not None
    assert max(map(len, description.splitlines())) <= 80


def test_usage_error_has_the_usage() -> None:
    with pytest.raises(UsageError, match=r"usage: rce env show(.|\n)*rce env show: error: .*required: ENV"):
        parser(table.COMMANDS["env show"]).parse_args([])


@pytest.mark.parametrize(("in_console", "expected"), [(False, ["--url"]), (True, [])])
def test_console_has_no_options_for_the_platform(in_console: bool, expected: list[str]) -> None:
    command = Command("try", "Try.", do_nothing, (argument("name"),))
    flags = [flag for each in command.all_arguments(in_console) for flag in each.flags]
    assert flags[0] == "name"
    assert [flag for flag in flags if flag == "--url"] == expected
    assert ("--url" in parser(command, "", in_console).format_help()) is not in_console


def test_arguments_may_be_computed_when_they_are_needed() -> None:
    command = Command("try", "Try.", do_nothing, lambda: (argument("--fast"),), platform=None)
    assert [each.flags for each in command.all_arguments()] == [("--fast",)]


def test_options_may_be_abbreviated_in_commands_that_the_console_lacks() -> None:
    command = Command("try", "Try.", do_nothing, (argument("--follow", action="store_true"),), section=Section.LOCAL)
    assert parser(command).parse_args(["--fol"]).follow
    with pytest.raises(UsageError, match="unrecognized arguments: --fol"):
        parser(command._replace(section=Section.PLATFORM)).parse_args(["--fol"])


def test_examples_begin_with_the_name_of_the_program() -> None:
    command = Command("try", "Try.", do_nothing, examples=("try one", "try two"), description="More about it.")
    text = parser(command).format_help()
    assert text.endswith("examples:\n  rce try one\n  rce try two\n")
    assert "Try.\n\nMore about it.\n" in text
    assert parser(command, "", in_console=True).format_help().endswith("examples:\n  try one\n  try two\n")


def test_lazy_function_is_that_of_the_module() -> None:
    lazy = Lazy("os.path", "basename")
    assert lazy("a/b") == "b"
    assert lazy.load() is posixpath.basename


def test_program_is_selected_by_any_arguments_unless_it_says_otherwise() -> None:
    assert Program("p", "", lambda words: 0, Section.SERVER).selected_by(["list"])
