"""The console's commands at a Master served in memory: signing in and out, contexts, lists, errors, scripts."""

from __future__ import annotations

import asyncio
import json
import stat
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from served import PASSWORD, Served, serve
from twisted.internet.base import ReactorBase

from rce import contexts
from rce import messages as m
from rce.api import Api, ServerEvent, read_events
from rce.commands import package
from rce.console.completing import Names, candidates
from rce.console.run import DONE, FAILED, WRONG, run
from rce.console.script import run_script
from rce.console.session import Session
from rce.errors import Unauthorized
from rce.views import EnvironmentView, Whoami


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Served]:
    """The user of these tests is not signed in anywhere, and has the password in the environment."""
    for name in ("RCE_URL", "RCE_USER", "RCE_KEY", "RCE_CONTEXT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("RCE_PASSWORD", PASSWORD)
    async with serve(reactor, tmp_path) as served:
        yield served


async def rce(*words: str) -> int:
    return await asyncio.to_thread(run, words)


async def login(served: Served, user: str, context: str) -> None:
    assert await rce("login", served.url, "--user", user, "--context", context) == DONE


async def test_who_signs_in_has_a_key_that_others_cannot_read(served: Served) -> None:
    await login(served, "ann", "home")
    assert stat.S_IMODE(contexts.place().stat().st_mode) == 0o600
    assert stat.S_IMODE(contexts.place().parent.stat().st_mode) == 0o700
    text = contexts.place().read_text()
    assert PASSWORD not in text
    (context,) = contexts.load().contexts.values()
    who = await asyncio.to_thread(Api(served.url, key=context.key).get, Whoami, "whoami")
    assert (who.user, who.role, who.key) == ("ann", "user", context.id)
    assert context.expires


async def test_who_signs_out_leaves_a_void_key(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "ann", "home")
    key = contexts.load().contexts["home"].key
    assert await rce("logout") == DONE
    assert not contexts.load().contexts
    with pytest.raises(Unauthorized):
        await asyncio.to_thread(Api(served.url, key=key).get, Whoami, "whoami")
    assert await rce("env", "list") == FAILED
    assert "rce login URL" in capsys.readouterr().err


async def test_commands_go_where_the_context_says(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "ann", "one")
    await login(served, "bob", "two")
    assert await rce("env", "create", "brain") == DONE
    assert await rce("env", "list", "--context", "one", "--json") == DONE
    assert capsys.readouterr().out.splitlines()[-1] == "[]"
    assert await rce("context", "use", "one") == DONE
    assert await rce("env", "show", "brain") == FAILED
    assert "there is no environment 'brain'" in capsys.readouterr().err
    assert await rce("context", "remove", "one") == DONE
    assert contexts.load().current == "two"
    assert await rce("context", "use", "one") == FAILED


async def test_other_commands_go_there_too(
    served: Served, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    await login(served, "ann", "home")
    monkeypatch.delenv("RCE_PASSWORD")
    assert await asyncio.to_thread(package.main, ["list", "--json"]) == DONE
    assert capsys.readouterr().out.splitlines()[-1] == "[]"
    with pytest.raises(Unauthorized):  # an address that is given has credentials of its own
        await asyncio.to_thread(package.main, ["list", "--url", served.url])


async def test_an_address_on_the_command_line_needs_no_context(served: Served) -> None:
    assert await rce("env", "list", "--url", served.url, "--user", "ann") == DONE
    assert await rce("env", "list", "--url", served.url) == FAILED


async def test_names_of_whom_it_is_about_are_offered(served: Served) -> None:
    for user in ("ann", "bob"):
        await served.master.execute(user, m.CreateContainer(f"{user}s"))
    await login(served, "olga", "home")

    def offered(line: str) -> set[str]:
        return set(candidates(line.split(" "), Names(Session())))

    for line, expected in (
        ("env show ", set()),
        ("env show --of bob ", {"bobs"}),
        ("env list --of all --machine ", set()),
        ("topic echo --of ann ", {"anns/"}),
        ("interface list --of all ", {"anns", "bobs"}),
    ):
        assert await asyncio.to_thread(offered, line) == expected, line


async def test_what_one_may_do_is_said_when_it_is_asked_for(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "vera", "home")
    assert await rce("whoami") == DONE
    assert "rights" not in capsys.readouterr().out
    assert await rce("whoami", "--rights") == DONE
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["data.read", "own"] in lines
    assert ["data.write", "-"] in lines


async def test_lists_are_read_page_by_page(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(7):
        await served.master.execute("ann", m.CreateContainer(f"e{number}"))
    monkeypatch.setattr("rce.api.PAGE", 3)
    api = Api(served.url, user="ann", password=PASSWORD)

    def read(limit: int = 0) -> list[EnvironmentView]:
        return list(api.items(EnvironmentView, "environments", limit=limit))

    assert [each.containerTag for each in await asyncio.to_thread(read)] == [f"e{number}" for number in range(7)]
    assert len(await asyncio.to_thread(lambda: read(4))) == 4


async def test_json_is_what_the_api_said(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served, "ann", "home")
    await rce("env", "create", "brain", "--memory", "1.5GiB", "--env", "A=b=c")
    await rce("param", "set", "brain", "frames", "[map, odom]")
    capsys.readouterr()
    await rce("env", "show", "brain", "--json")
    shown = json.loads(capsys.readouterr().out)
    assert shown == (await served.ask("GET", "/environments/brain")).body
    assert (shown["containerData"]["memory"], shown["containerData"]["env"]) == (3 * 2**29, {"A": "b=c"})
    await rce("param", "get", "brain", "frames")
    assert capsys.readouterr().out == "[map, odom]\n"


@pytest.mark.parametrize(
    ("line", "status", "text"),
    [
        ("env create brain", FAILED, "brain is in use"),
        ("env create b2 --memory lots", FAILED, "is not a size"),
        ("env create b2 --env A", FAILED, "write NAME=VALUE"),
        ("interface show brain", FAILED, "endpointTag/interfaceTag"),
        ("machine list", FAILED, "may not: machine.read; that takes the role operator, admin"),
        ("audit --since yesterday", FAILED, "is no time"),
        ("topic echo brain", FAILED, "write ENV/NAME"),
        ("env create", WRONG, "usage: rce env create"),
    ],
)
async def test_errors_say_what_to_do(
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
async def test_a_script(served: Served, capsys: pytest.CaptureFixture[str], keep_going: bool, made: list[str]) -> None:
    session = Session(served.url, "ann")
    status = await asyncio.to_thread(run_script, SCRIPT.splitlines(), session, "setup", keep_going)
    assert status == FAILED
    assert "setup:5: status 1: env show nobody" in capsys.readouterr().err
    found = (await served.ask("GET", "/environments")).body["items"]
    assert [each["containerTag"] for each in found] == made


async def test_a_script_ends_at_exit(served: Served) -> None:
    session = Session(served.url, "ann")
    assert await asyncio.to_thread(run_script, ["env create one", "exit", "env create two"], session) == DONE
    assert len((await served.ask("GET", "/environments")).body["items"]) == 1


def test_server_sent_events_are_read() -> None:
    lines = [": beat", "", "event: node.died", "id: 7", "data: {", "data:}", "", "data: x", "", "data: unfinished"]
    assert list(read_events(iter(lines))) == [ServerEvent("node.died", "{\n}", "7"), ServerEvent("message", "x", "7")]
