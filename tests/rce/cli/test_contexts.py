"""Contexts, and the platform that a command line selects."""

from __future__ import annotations

import argparse
import stat
from pathlib import Path

import pytest

from rce.cli import contexts
from rce.cli.arguments import DEV_USER, LOCAL_URL
from rce.cli.contexts import Access, Context, Contexts
from rce.cli.execute import FAILURE, SUCCESS
from rce.errors import InvalidRequest, NotFound, Unauthorized
from tests.support.console import login, rce
from tests.support.master.served import Served


async def test_commands_use_the_platform_of_the_context(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served.url, "ann", "one")
    await login(served.url, "bob", "two")
    assert await rce("env", "create", "brain") == SUCCESS
    assert await rce("env", "list", "--context", "one", "--json") == SUCCESS
    assert capsys.readouterr().out.splitlines()[-1] == "[]"
    assert await rce("context", "use", "one") == SUCCESS
    assert await rce("env", "show", "brain") == FAILURE
    assert "there is no environment 'brain'" in capsys.readouterr().err
    assert await rce("context", "remove", "one") == SUCCESS
    assert contexts.load().current == ""
    assert await rce("context", "use", "one") == FAILURE


async def test_address_on_the_command_line_needs_no_context(served: Served) -> None:
    assert await rce("env", "list", "--url", served.url, "--user", "ann") == SUCCESS
    assert await rce("env", "list", "--url", served.url) == FAILURE


HOME = Context("https://home:9000/", "ann", "rce_home", "1f")
WORK = Context("https://work:9000/", "bob", "rce_work", "2f", expires=2e9)
SIGNED_IN_HOME = Access(HOME.url, "ann", None, "rce_home")
SIGNED_IN_WORK = Access(WORK.url, "bob", None, "rce_work")


OTHER_PORT = "http://127.0.0.1:9001/"


@pytest.fixture
def two_contexts(no_context: Path) -> Path:
    contexts.save(Contexts("home", {"home": HOME, "work": WORK}))
    return no_context


def test_without_a_file_there_are_no_contexts(no_context: Path) -> None:
    assert contexts.load() == Contexts()
    with pytest.raises(Unauthorized, match="rce login URL"):
        contexts.access()


def test_saved_contexts_are_read_again(two_contexts: Path) -> None:
    assert contexts.contexts_path() == two_contexts
    assert contexts.load() == Contexts("home", {"home": HOME, "work": WORK})
    assert [path.name for path in two_contexts.parent.iterdir()] == ["contexts.json"]


def test_file_stays_private_when_it_is_replaced(two_contexts: Path) -> None:
    two_contexts.chmod(0o644)
    contexts.save(Contexts())
    assert stat.S_IMODE(two_contexts.stat().st_mode) == 0o600


@pytest.mark.parametrize("content", ["{", '{"contexts": {"home": {}}}'])
def test_damaged_file_is_named(content: str, two_contexts: Path) -> None:
    two_contexts.write_text(content)
    with pytest.raises(InvalidRequest, match=f"cannot read {two_contexts}: .*sign in again"):
        contexts.load()


def test_unknown_context_is_answered_with_the_existing_ones(two_contexts: Path) -> None:
    with pytest.raises(NotFound, match=r"no context 'moon' \(existing: home, work\)"):
        contexts.load().named("moon")


def set_variables(monkeypatch: pytest.MonkeyPatch, variables: dict[str, str]) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize(
    ("options", "variables", "expected"),
    [
        ({}, {}, SIGNED_IN_HOME),
        ({"context": "work"}, {}, SIGNED_IN_WORK),
        ({}, {"RCE_CONTEXT": "work"}, SIGNED_IN_WORK),
        ({"context": "home"}, {"RCE_CONTEXT": "work"}, SIGNED_IN_HOME),
        ({"context": "work"}, {"RCE_URL": "http://a/", "RCE_KEY": "rce_k"}, SIGNED_IN_WORK),
        (
            {},
            {"RCE_CONTEXT": "work", "RCE_URL": "http://a/", "RCE_KEY": "rce_k"},
            Access("http://a/", "", None, "rce_k"),
        ),
        ({}, {"RCE_KEY": "rce_k"}, SIGNED_IN_HOME),
        ({"url": "http://a/"}, {"RCE_KEY": "rce_k"}, Access("http://a/", "", None, "rce_k")),
        ({}, {"RCE_URL": "http://a/", "RCE_KEY": "rce_k"}, Access("http://a/", "", None, "rce_k")),
        ({"url": "http://a/", "user": "eve"}, {"RCE_PASSWORD": "pw"}, Access("http://a/", "eve", "pw", None)),
        ({"url": "http://a/"}, {"RCE_PASSWORD": "pw", "RCE_USER": "eve"}, Access("http://a/", "eve", "pw", None)),
        (
            {"url": "http://a/", "user": "eve"},
            {"RCE_PASSWORD": "pw", "RCE_KEY": "rce_k"},
            Access("http://a/", "eve", "pw", None),
        ),
        ({"url": "https://work:9000"}, {}, Access("https://work:9000", "bob", None, "rce_work")),
        ({"url": "https://work:9000/", "user": "bob"}, {}, SIGNED_IN_WORK),
    ],
)
def test_options_come_before_variables_before_contexts(
    options: dict[str, str],
    variables: dict[str, str],
    expected: Access,
    two_contexts: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    set_variables(monkeypatch, variables)
    assert contexts.access(**options) == expected


@pytest.mark.parametrize("options", [{"url": "http://other/"}, {"url": "https://work:9000/", "user": "ann"}])
def test_key_of_another_platform_or_user_is_not_used(options: dict[str, str], two_contexts: Path) -> None:
    with pytest.raises(Unauthorized, match=r"no credentials (of user ann )?for"):
        contexts.access(**options)


def test_password_without_a_user_is_refused(two_contexts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RCE_PASSWORD", "pw")
    with pytest.raises(Unauthorized, match="give --user or set RCE_USER"):
        contexts.access(url="http://a/")


@pytest.mark.parametrize(
    ("given", "variables", "expected"),
    [
        ({}, {}, SIGNED_IN_HOME),
        ({"url": OTHER_PORT}, {}, Access(OTHER_PORT, DEV_USER, DEV_USER, None)),
        ({"url": HOME.url}, {}, SIGNED_IN_HOME),
        ({"context": "work"}, {"RCE_KEY": "rce_k"}, SIGNED_IN_WORK),
        ({"password": "pw"}, {"RCE_KEY": "rce_k"}, Access(LOCAL_URL, DEV_USER, "pw", None)),
        ({}, {"RCE_KEY": "rce_k"}, Access(LOCAL_URL, DEV_USER, None, "rce_k")),
        ({"user": "eve"}, {"RCE_PASSWORD": "pw"}, Access(LOCAL_URL, "eve", "pw", None)),
        ({}, {"RCE_URL": OTHER_PORT}, Access(OTHER_PORT, DEV_USER, DEV_USER, None)),
        ({}, {"RCE_URL": "http://a/", "RCE_KEY": "rce_k"}, Access("http://a/", DEV_USER, None, "rce_k")),
        (
            {},
            {"RCE_URL": "http://a/", "RCE_USER": "eve", "RCE_PASSWORD": "pw"},
            Access("http://a/", "eve", "pw", None),
        ),
        ({"url": OTHER_PORT}, {"RCE_URL": "http://a/"}, Access(OTHER_PORT, DEV_USER, DEV_USER, None)),
        ({"user": "eve"}, {"RCE_USER": "bob", "RCE_PASSWORD": "pw"}, Access(LOCAL_URL, "eve", "pw", None)),
        ({}, {"RCE_CONTEXT": "work"}, SIGNED_IN_WORK),
    ],
)
def test_running_platform_is_the_current_context_unless_options_say_otherwise(
    given: dict[str, str],
    variables: dict[str, str],
    expected: Access,
    two_contexts: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    set_variables(monkeypatch, variables)
    args = argparse.Namespace(**{"url": "", "user": "", "password": None} | given)
    assert contexts.running_platform(args) == expected


@pytest.mark.parametrize(
    ("given", "variables", "reason"),
    [
        ({"url": "http://a/"}, {}, "no credentials for http://a/"),
        ({"url": "http://a/"}, {"RCE_PASSWORD": "pw"}, "give --user or set RCE_USER"),
        ({"user": "eve"}, {}, "no credentials of user eve"),
    ],
)
def test_running_platform_elsewhere_is_not_asked_with_credentials_of_development(
    given: dict[str, str],
    variables: dict[str, str],
    reason: str,
    two_contexts: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Wrong passwords would count towards the delay of the next login."""
    set_variables(monkeypatch, variables)
    with pytest.raises(Unauthorized, match=reason):
        contexts.running_platform(argparse.Namespace(**{"url": "", "user": "", "password": None} | given))


def test_running_platform_without_a_context_is_one_of_development(no_context: Path) -> None:
    args = argparse.Namespace(url="", user="", password=None)
    assert contexts.running_platform(args) == Access(LOCAL_URL, DEV_USER, DEV_USER, None)
