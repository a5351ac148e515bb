"""The console's commands at a Master served in memory: login, contexts, lists, errors, scripts."""

from __future__ import annotations

import asyncio
import json
import stat
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from rce.api.client import ApiClient, ServerEvent, read_events
from rce.api.views import EnvironmentView, Whoami
from rce.cli import contexts
from rce.cli.completion import Names, candidates
from rce.cli.execute import FAILURE, SUCCESS, USAGE_ERROR, run
from rce.cli.script import run_script
from rce.cli.session import ConsoleSession
from rce.errors import Unauthorized
from rce.protocol import messages as m
from tests.support.master.served import PASSWORD, Served, serve


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Served]:
    """A served Master, for a user without contexts whose password is in the environment."""
    for name in ("RCE_URL", "RCE_USER", "RCE_KEY", "RCE_CONTEXT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("RCE_PASSWORD", PASSWORD)
    async with serve(reactor, tmp_path) as served:
        yield served


async def rce(*words: str) -> int:
    return await asyncio.to_thread(run, words)


async def login(served: Served, user: str, context: str) -> None:
    assert await rce("login", served.url, "--user", user, "--context", context) == SUCCESS


async def test_login_keeps_a_key_that_only_its_user_can_read(served: Served) -> None:
    await login(served, "ann", "home")
    assert stat.S_IMODE(contexts.contexts_path().stat().st_mode) == 0o600
    assert stat.S_IMODE(contexts.contexts_path().parent.stat().st_mode) == 0o700
    text = contexts.contexts_path().read_text()
    assert PASSWORD not in text
    (context,) = contexts.load().contexts.values()
    me = await asyncio.to_thread(ApiClient(served.url, key=context.key).get, Whoami, "whoami")
    assert (me.user, me.role, me.key) == ("ann", "user", context.id)
    assert context.expires


async def test_logout_revokes_the_key(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "ann", "home")
    key = contexts.load().contexts["home"].key
    assert await rce("logout") == SUCCESS
    assert not contexts.load().contexts
    with pytest.raises(Unauthorized):
        await asyncio.to_thread(ApiClient(served.url, key=key).get, Whoami, "whoami")
    assert await rce("env", "list") == FAILURE
    assert "rce login URL" in capsys.readouterr().err


async def test_commands_use_the_platform_of_the_context(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "ann", "one")
    await login(served, "bob", "two")
    assert await rce("env", "create", "brain") == SUCCESS
    assert await rce("env", "list", "--context", "one", "--json") == SUCCESS
    assert capsys.readouterr().out.splitlines()[-1] == "[]"
    assert await rce("context", "use", "one") == SUCCESS
    assert await rce("env", "show", "brain") == FAILURE
    assert "there is no environment 'brain'" in capsys.readouterr().err
    assert await rce("context", "remove", "one") == SUCCESS
    assert contexts.load().current == "two"
    assert await rce("context", "use", "one") == FAILURE


async def test_package_uses_the_current_context_unless_given_an_address(
    served: Served, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    await login(served, "ann", "home")
    monkeypatch.delenv("RCE_PASSWORD")
    assert await rce("package", "list", "--json") == SUCCESS
    assert capsys.readouterr().out.splitlines()[-1] == "[]"
    assert await rce("package", "list", "--url", served.url) == FAILURE


async def test_address_on_the_command_line_needs_no_context(served: Served) -> None:
    assert await rce("env", "list", "--url", served.url, "--user", "ann") == SUCCESS
    assert await rce("env", "list", "--url", served.url) == FAILURE


async def test_completion_offers_names_of_the_user_given_by_of(served: Served) -> None:
    for user in ("ann", "bob"):
        await served.master.commands.execute(user, m.CreateContainer(f"{user}s"))
    await login(served, "olga", "home")

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


async def test_whoami_lists_permissions_on_request(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "vera", "home")
    assert await rce("whoami") == SUCCESS
    assert "rights" not in capsys.readouterr().out
    assert await rce("whoami", "--rights") == SUCCESS
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["data.read", "own"] in lines
    assert ["data.write", "-"] in lines


async def test_api_client_reads_lists_page_by_page(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(7):
        await served.master.commands.execute("ann", m.CreateContainer(f"e{number}"))
    monkeypatch.setattr("rce.api.client.PAGE_SIZE", 3)
    api = ApiClient(served.url, user="ann", password=PASSWORD)

    def read(limit: int = 0) -> list[EnvironmentView]:
        return list(api.items(EnvironmentView, "environments", limit=limit))

    assert [each.containerTag for each in await asyncio.to_thread(read)] == [f"e{number}" for number in range(7)]
    assert len(await asyncio.to_thread(lambda: read(4))) == 4


async def test_json_output_is_the_response_of_the_api(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "ann", "home")
    await rce("env", "create", "brain", "--memory", "1.5GiB", "--env", "A=b=c")
    await rce("param", "set", "brain", "frames", "[map, odom]")
    capsys.readouterr()
    await rce("env", "show", "brain", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed == (await served.ask("GET", "/environments/brain")).body
    assert (printed["containerData"]["memory"], printed["containerData"]["env"]) == (3 * 2**29, {"A": "b=c"})
    await rce("param", "get", "brain", "frames")
    assert capsys.readouterr().out == "[map, odom]\n"


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
    await login(served, "ann", "home")
    await rce("env", "create", "brain")
    assert await rce(*line.split()) == status
    assert text in capsys.readouterr().err


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


def test_server_sent_events_are_parsed() -> None:
    lines = [": beat", "", "event: node.died", "id: 7", "data: {", "data:}", "", "data: x", "", "data: unfinished"]
    assert list(read_events(iter(lines))) == [ServerEvent("node.died", "{\n}", "7"), ServerEvent("message", "x", "7")]
