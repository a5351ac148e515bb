"""Completion of command lines."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from rce.api.views import RosPackage
from rce.cli.arguments import Completion
from rce.cli.completion import Names, candidates
from rce.cli.session import ConsoleSession
from rce.protocol import messages as m
from tests.support.console import Console, login
from tests.support.master.served import Served


class FakeNames(Names):
    def __init__(self) -> None:
        super().__init__(ConsoleSession())

    def find(self, kind: Completion, words: Sequence[str] = ()) -> list[str]:
        return {"environment": ["brain", "brawn"], "interface": ["brain/pose"], "user": ["ada"]}.get(kind, [])


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("en", {"env", "environment"}),
        ("ma", {"machine", "map", "map-service", "map3d", "master"}),
        ("com", {"completion"}),
        ("env sh", {"show", "shell"}),
        ("env show bra", {"brain", "brawn"}),
        ("env show --j", {"--json"}),
        ("env create --restart ", {"always", "no"}),
        ("connect brain/pose b", {"brain/pose"}),
        ("env list --of ", {"ada"}),
        ("watch env de", {"delete"}),
        ("watch map", set()),
        ("help map s", {"submit", "status"}),
        ("env delete brain b", {"brain", "brawn"}),
        ("env show brain b", set()),
        ("nothing ", set()),
        ("completion ", {"bash", "zsh", "fish"}),
        ("map s", {"submit", "status"}),
        ("map --mapper ", {"graph", "particle"}),
        ("map x.log --engine d", {"docker"}),
        ("package pu", {"push"}),
        ("bench rtt --q", {"--quick"}),
        ("robot ", {"list", "show", "disconnect"}),
    ],
)
def test_completion_on_the_command_line(line: str, expected: set[str]) -> None:
    words = line.split() + ([""] if line.endswith(" ") else [])
    assert set(candidates(words, FakeNames())) == expected


@pytest.mark.parametrize(
    ("line", "expected"), [("en", {"env"}), ("ma", {"machine"}), ("help ma", {"machine"}), ("env list --u", set())]
)
def test_console_completes_its_own_commands_without_platform_options(line: str, expected: set[str]) -> None:
    assert set(candidates(line.split(), FakeNames(), in_console=True)) == expected


def test_command_line_completes_platform_options() -> None:
    assert set(candidates(["env", "list", "--u"], FakeNames())) == {"--url", "--user"}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("node start brain echo ", {"demo", "nav"}),
        ("node start brain echo demo ", {"listen", "talk"}),
        ("node start brain echo demo t", {"talk"}),
        ("node executables brain n", {"nav"}),
    ],
)
def test_packages_and_executables_are_those_of_the_environment(line: str, expected: set[str]) -> None:
    console = Console([RosPackage("demo", ["listen", "talk"]), RosPackage("nav", ["plan"])])
    assert set(candidates(line.split(" "), Names(console.session))) == expected
    assert [each.line for each in console.api.requests] == ["GET environments/brain/packages"]


async def test_completion_offers_names_of_the_user_given_by_of(served: Served) -> None:
    for user in ("ann", "bob"):
        await served.master.commands.execute(user, m.CreateContainer(f"{user}s"))
    await login(served.url, "olga", "home")

    def completed(line: str) -> set[str]:
        return set(candidates(line.split(" "), Names(ConsoleSession())))

    for line, expected in (
        ("env show ", set()),
        ("env show --of bob ", {"bobs"}),
        ("env list --of all --machine ", set()),
        ("topic echo --of ann ", {"anns/"}),
        ("interface list --of all ", {"anns", "bobs"}),
    ):
        assert await asyncio.to_thread(completed, line) == expected, line
