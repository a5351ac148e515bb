"""Lines of the console and scripts."""

from __future__ import annotations

import asyncio

import pytest

from rce.cli.execute import FAILURE, INTERRUPTED, SUCCESS, USAGE_ERROR
from rce.cli.script import run_line, run_script
from rce.cli.session import ConsoleSession
from rce.errors import NotFound
from tests.support.console import Console
from tests.support.master.served import Served

SCRIPT = """\
# comment
env create brain   # the spelling of the original:
container start -n "c1"

env show nobody
rce env create last
"""


@pytest.mark.parametrize(("keep_going", "made"), [(False, ["brain", "c1"]), (True, ["brain", "c1", "last"])])
async def test_script_stops_at_a_failure_unless_told_to_keep_going(
    served: Served, capsys: pytest.CaptureFixture[str], keep_going: bool, made: list[str]
) -> None:
    session = ConsoleSession(served.url, "ann")
    status = await asyncio.to_thread(run_script, SCRIPT.splitlines(), session, "setup", keep_going)
    assert status == FAILURE
    assert "setup:5: status 1: env show nobody" in capsys.readouterr().err
    found = (await served.ask("GET", "/environments")).body["items"]
    assert [each["containerTag"] for each in found] == made


async def test_exit_ends_a_script(served: Served) -> None:
    session = ConsoleSession(served.url, "ann")
    assert await asyncio.to_thread(run_script, ["env create one", "exit", "env create two"], session) == SUCCESS
    assert len((await served.ask("GET", "/environments")).body["items"]) == 1


@pytest.mark.parametrize("line", ["", "   ", "# env list", "rce"])
def test_line_without_a_command_does_nothing(line: str) -> None:
    console = Console()
    assert run_line(line, console.session) == SUCCESS
    assert not console.api.requests


@pytest.mark.parametrize("line", ["env delete 'my brain'  # it is done", "rce env delete 'my brain'"])
def test_line_is_split_as_by_a_shell(line: str) -> None:
    console = Console()
    assert run_line(line, console.session) == SUCCESS
    assert [each.line for each in console.api.requests] == ["DELETE environments/my brain"]


def test_unclosed_quote_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_line("env delete 'brain", ConsoleSession()) == USAGE_ERROR
    assert capsys.readouterr().err == "cannot parse the line: No closing quotation\n"


@pytest.mark.parametrize("line", ["exit", "quit", "rce exit"])
def test_exit_leaves_the_console(line: str) -> None:
    with pytest.raises(SystemExit):
        run_line(line, ConsoleSession())


def test_status_of_a_script_is_that_of_its_first_failure() -> None:
    console = Console(NotFound("gone"))
    assert run_script(["env delete a", "nothing", "exit", "env delete b"], console.session, keep_going=True) == FAILURE
    assert len(console.api.requests) == 1


def test_ctrl_c_ends_a_script_that_keeps_going(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console(KeyboardInterrupt())
    assert run_script(["env delete a", "env delete b"], console.session, keep_going=True) == INTERRUPTED
    assert len(console.api.requests) == 1
    assert capsys.readouterr().err == "<stdin>:1: status 130: env delete a\n"
