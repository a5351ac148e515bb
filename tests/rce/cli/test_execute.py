"""Execution of command lines: results, errors and exit statuses."""

from __future__ import annotations

import errno

import pytest

from rce.cli import table
from rce.cli.execute import FAILURE, INTERRUPTED, SUCCESS, USAGE_ERROR, print_help, run
from rce.cli.session import ConsoleSession
from rce.errors import NotFound
from tests.support.console import Console, login, rce
from tests.support.master.served import Served


@pytest.mark.parametrize(
    ("line", "status", "text"),
    [
        ("env create brain", FAILURE, "brain is in use"),
        ("env create b2 --memory lots", FAILURE, "is not a size"),
        ("env create b2 --env A", FAILURE, "write NAME=VALUE"),
        ("interface show brain", FAILURE, "endpointTag/interfaceTag"),
        ("machine list", FAILURE, "may not: machine.read; it needs the role operator or admin"),
        ("audit --since yesterday", FAILURE, "is not a time"),
        ("topic echo brain", FAILURE, "write ENV/NAME"),
        ("env create", USAGE_ERROR, "usage: rce env create"),
    ],
)
async def test_error_explains_what_to_do(
    served: Served, capsys: pytest.CaptureFixture[str], line: str, status: int, text: str
) -> None:
    await login(served.url, "ann", "home")
    await rce("env", "create", "brain")
    assert await rce(*line.split()) == status
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("env", "env create"),
        ("env made", "rce: there is no command 'env made'"),
        ("env show", "required: ENV"),
        ("env show a --jsn", "unrecognized arguments: --jsn: did you mean --json?"),
        ("env show a --xyz", "unrecognized arguments: --xyz\n"),
        ("env create a --memroy 5", "unrecognized arguments: --memroy 5: did you mean --memory?"),
        ("env remove", "no command 'env remove': did you mean delete?"),
        ("interface rm", "no command 'interface rm': did you mean remove?"),
        ("nonsense", "there is no command 'nonsense'"),
        ("bench", "bench rtt"),
        ("package", "package push"),
        ("map submit", "required: FILE"),
    ],
)
def test_wrong_command_line_is_answered_with_usage(line: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(line.split()) == USAGE_ERROR
    printed = capsys.readouterr()
    assert text in printed.out + printed.err


def test_console_does_not_run_commands_of_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["map", "status"], ConsoleSession()) == USAGE_ERROR
    assert capsys.readouterr().err == "console: there is no command 'map'; `help` lists them\n"


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("env create", "usage: rce env create "),
        ("env", "usage: rce env COMMAND"),
        ("map", "usage: rce map "),
        ("bench", "Measure a platform."),
        ("robot", "robot disconnect"),
        ("container start -n c1", "usage: rce env create "),
    ],
)
def test_help_explains_a_command(line: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["help", *line.split()]) == SUCCESS
    assert text in capsys.readouterr().out


def test_help_in_the_console_shows_usage_without_rce(capsys: pytest.CaptureFixture[str]) -> None:
    assert print_help(["env", "create"], in_console=True) == SUCCESS
    assert capsys.readouterr().out.startswith("usage: env create ")


@pytest.mark.parametrize("line", ["container -h", "container --help", "help container"])
def test_help_of_a_command_of_the_original_lists_its_forms(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = line.split()
    status = print_help(words[1:], in_console=True) if words[0] == "help" else run(words, ConsoleSession())
    assert status == SUCCESS
    assert "container -t, --stop STOP" in capsys.readouterr().out


def test_incomplete_command_of_the_original_is_answered_with_its_forms(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["container", "start"], ConsoleSession()) == USAGE_ERROR
    assert "container start -n, --name NAME" in capsys.readouterr().err


def test_error_of_the_platform_is_printed_after_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console(NotFound("there is no environment 'a'")).run("env delete a") == FAILURE
    assert capsys.readouterr().err == "env: there is no environment 'a'\n"


@pytest.mark.parametrize(
    ("words", "hint"), [(["nod", "list"], "did you mean node?"), (["env", "lst"], "did you mean list?")]
)
def test_misspelt_command_is_answered_with_the_nearest(
    words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words) == USAGE_ERROR
    assert capsys.readouterr().err.endswith(f"{hint}\n")


@pytest.mark.parametrize(
    ("line", "path"),
    [
        ("node show brain/echo", "environments/brain/nodes/echo"),
        ("node show --of ann brain/echo", "environments/brain/nodes/echo"),
        ("node show brain echo", "environments/brain/nodes/echo"),
        ("param get brain/rate", "environments/brain/parameters/rate"),
    ],
)
def test_things_of_an_environment_are_named_with_a_slash_too(line: str, path: str) -> None:
    console = Console(NotFound("there is none"))
    console.run(line)
    assert [each.line for each in console.api.requests] == [f"GET {path}"]


def test_missing_file_is_printed_with_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    error = FileNotFoundError(errno.ENOENT, "No such file or directory", "a.log")
    assert Console(error).run("env delete a") == FAILURE
    assert capsys.readouterr().err == "env: a.log: no such file or directory\n"


def test_broken_output_is_left_to_the_caller() -> None:
    with pytest.raises(BrokenPipeError):
        Console(BrokenPipeError(errno.EPIPE, "Broken pipe")).run("env delete a")


def test_ctrl_c_has_a_status_of_its_own() -> None:
    assert Console(KeyboardInterrupt()).run("env delete a") == INTERRUPTED


def test_help_of_a_command_is_no_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["env", "show", "--help"]) == SUCCESS
    assert capsys.readouterr().out.startswith("usage: rce env show ")


def test_help_of_a_program_is_the_programs_own(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []

    def master(words: list[str]) -> int:
        asked.append(words)
        return 7

    monkeypatch.setitem(table.PROGRAMS, "master", table.PROGRAMS["master"]._replace(run=master))
    assert print_help(["master"], in_console=False) == 7
    assert run(["master", "--dev"]) == 7
    assert asked == [["--help"], ["--dev"]]


def test_help_of_an_unknown_command_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert print_help(["mapp"], in_console=False) == USAGE_ERROR
    assert "rce: there is no command 'mapp'" in capsys.readouterr().err
