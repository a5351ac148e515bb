"""Command lines of `rce bag`."""

from __future__ import annotations

from rce.cli.commands.bags import COMMANDS


def test_commands_are_those_of_the_group() -> None:
    assert [command.name for command in COMMANDS] == ["bag record", "bag play", "bag info"]
    assert [command.in_console for command in COMMANDS] == [True, True, False]
