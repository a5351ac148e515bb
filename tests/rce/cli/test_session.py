"""State that the commands of a console share."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import pytest

from rce.api.views import Whoami
from rce.cli import contexts
from rce.cli.contexts import Access, Context, Contexts
from rce.cli.session import ConsoleSession, user_query
from rce.errors import Unauthorized
from tests.support.console import ACCESS, Console

HOME = Context("http://127.0.0.1:1/", "ann", "rce_home", "1f")
WORK = Context("http://127.0.0.1:2/", "bob", "rce_work", "2f")


@pytest.fixture
def two_contexts(no_context: Path) -> None:
    contexts.save(Contexts("home", {"home": HOME, "work": WORK}))


@pytest.mark.parametrize(("of", "query"), [("", ""), ("eve", "eve"), ("all", "*")])
def test_all_users_are_a_star_in_queries(of: str, query: str) -> None:
    assert user_query(of) == query


@pytest.mark.usefixtures("two_contexts")
def test_options_of_the_command_line_select_the_platform() -> None:
    session = ConsoleSession.from_arguments(argparse.Namespace(context="work"))
    assert session.access == Access(WORK.url, "bob", None, "rce_work")


@pytest.mark.usefixtures("two_contexts")
def test_selected_context_is_used_from_the_next_command_on() -> None:
    session = ConsoleSession()
    assert (session.access.user, session.user) == ("ann", "ann")
    api = session.api
    session.use_context("work")
    assert (session.access.user, session.user) == ("bob", "bob")
    assert session.api is not api


@pytest.mark.usefixtures("two_contexts")
def test_platform_is_looked_up_again_after_a_logout() -> None:
    session = ConsoleSession()
    assert session.access.user == "ann"
    contexts.save(Contexts())
    assert session.access.user == "ann"
    session.forget_access()
    with pytest.raises(Unauthorized):
        session.access  # noqa: B018


def test_platform_is_asked_for_the_user_of_a_key_once() -> None:
    console = Console(Whoami("eve", "user"))
    console.session.__dict__["access"] = Access(ACCESS.url, "", None, "rce_k")
    assert [console.session.user, console.session.user] == ["eve", "eve"]
    assert [each.line for each in console.api.requests] == ["GET whoami"]


def test_each_guest_has_a_name_of_its_own() -> None:
    session = Console().session
    one, other = session.guest("eve"), session.guest("")
    assert re.fullmatch(r"@console_[0-9a-f]{6}", one.name)
    assert one.name != other.name
