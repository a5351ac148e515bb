"""Rights of principals, and pages of the resources that a user may see."""

from __future__ import annotations

import pytest

from master.access.rights import EVERYBODY
from master.api.principals import (
    authorize,
    authorize_list,
    authorize_platform,
    find_environment,
    page_of_records,
    page_of_views,
    principal_of,
)
from master.api.request import Answer, PageQuery
from master.graph.records import Environment, EnvironmentOptions, Robot
from master.graph.state import State
from rce.api.roles import Principal, Scopes
from rce.api.views import Page
from rce.errors import Forbidden, NotFound, Unauthorized
from rce.protocol import messages as m
from tests.support.master.calls import make_call
from tests.support.master.served import Served

ANN, OLGA = Principal("ann", "user"), Principal("olga", "operator")


def test_call_of_a_public_route_has_no_principal() -> None:
    with pytest.raises(Unauthorized):
        principal_of(make_call(None))
    assert principal_of(make_call(ANN)) == ANN


def test_owner_is_the_caller_unless_another_is_named() -> None:
    call = make_call(OLGA)
    assert authorize(call, "robot.read", "") == "olga"
    assert authorize(call, "robot.read", "ann") == "ann"
    assert (call.audit.operation, call.audit.owner) == ("robot.read", "ann")


def test_refused_operation_is_noted_for_the_audit_log() -> None:
    call = make_call(ANN)
    with pytest.raises(NotFound):
        authorize(call, "environment.remove", "bob")
    assert (call.audit.operation, call.audit.owner) == ("environment.remove", "bob")


def test_scopes_of_a_key_are_checked() -> None:
    call = make_call(Principal("ann", "robot", "k", scopes=Scopes("r1", ["brain"])))
    assert authorize(call, "robot.read", "", robot="r1") == "ann"
    assert authorize(call, "node.read", "", environment="brain") == "ann"
    with pytest.raises(NotFound):
        authorize(call, "robot.read", "", robot="r2")
    with pytest.raises(NotFound):
        authorize(call, "node.read", "", environment="attic")


def test_platform_belongs_to_those_with_rights_over_all() -> None:
    authorize_platform(make_call(OLGA), "machine.read")
    with pytest.raises(Forbidden):
        authorize_platform(make_call(ANN), "machine.read")


def test_list_of_everybody_has_what_the_caller_may_see() -> None:
    assert authorize_list(make_call(OLGA), "robot.read", EVERYBODY) == EVERYBODY
    assert authorize_list(make_call(ANN), "robot.read", EVERYBODY) == "ann"
    assert authorize_list(make_call(ANN), "robot.read", "") == "ann"
    with pytest.raises(NotFound):
        authorize_list(make_call(ANN), "robot.read", "bob")
    with pytest.raises(Forbidden):
        authorize_list(make_call(ANN), "machine.read", EVERYBODY)


def test_environment_of_the_path_is_found_with_the_rights_to_it() -> None:
    state = State()
    for name in ("ann/brain", "ann/attic", "bob/brain"):
        state.environments.put(Environment(name, EnvironmentOptions(), "0", ""))

    def find(principal: Principal, tag: str, user: str = "") -> str:
        call = make_call(principal, variables={"environment": tag})
        return find_environment(call, state, "node.read", user).name

    assert find(ANN, "brain") == "ann/brain"
    assert find(OLGA, "brain", "bob") == "bob/brain"
    tied = Principal("ann", "robot", "k", scopes=Scopes(environments=["brain"]))
    for principal, tag, user in ((ANN, "none", ""), (ANN, "brain", "bob"), (OLGA, "brain", ""), (tied, "attic", "")):
        with pytest.raises(NotFound):
            find(principal, tag, user)


# --- pages ------------------------------------------------------------------------------------------------------------


def contents(answer: Answer) -> tuple[list[str], str]:
    assert isinstance(answer.body, Page)
    return answer.body.items, answer.body.next


@pytest.mark.parametrize(
    ("limit", "after", "items", "next_key"),
    [
        (5, "", ["A", "B", "C", "D"], ""),
        (4, "", ["A", "B", "C", "D"], ""),
        (3, "", ["A", "B", "C"], "c"),
        (3, "c", ["D"], ""),
        (3, "bb", ["C", "D"], ""),
        (3, "d", [], ""),
    ],
)
def test_page_is_in_the_order_of_keys(limit: int, after: str, items: list[str], next_key: str) -> None:
    keyed = [("d", "D"), ("b", "B"), ("a", "A"), ("c", "C")]
    assert contents(page_of_views(keyed, PageQuery(limit, after))) == (items, next_key)


def test_page_is_full_although_some_are_left_out() -> None:
    keyed = [(letter, letter.upper()) for letter in "abcdef"]
    page = page_of_views(keyed, PageQuery(2), lambda each: each not in "AC")
    assert contents(page) == (["B", "D"], "d")


def test_page_of_records_has_those_of_the_user() -> None:
    records = [Robot(name, "west", "") for name in ("bob/a", "ann/b", "ann/a", "anna/a")]

    def names(user: str, after: str = "") -> list[str]:
        return contents(page_of_records(records, user, PageQuery(10, after), lambda each: each.name))[0]

    assert names("ann") == ["ann/a", "ann/b"]
    assert names("ann", after="ann/a") == ["ann/b"]
    assert names(EVERYBODY) == ["ann/a", "ann/b", "anna/a", "bob/a"]


async def test_pages_list_each_item_once_while_others_change(populated: Served) -> None:
    for number in range(5):
        await populated.master.commands.execute("ann", m.SetParameter("brain", f"p{number}", number))
    path = "/environments/brain/parameters?node=&limit=2"
    first = (await populated.ask("GET", path)).body
    await populated.master.commands.execute("ann", m.DeleteParameter("brain", first["items"][1]["name"]))
    await populated.master.commands.execute("ann", m.SetParameter("brain", "aa", 0))
    seen = [each["name"] for each in first["items"]]
    page = first
    while page["next"]:
        page = (await populated.ask("GET", f"{path}&after={page['next'].replace('/', '%2F')}")).body
        seen += [each["name"] for each in page["items"]]
    assert seen == ["arm/gain", "p0", "p1", "p2", "p3", "p4"]


async def test_other_users_resources_are_not_found(populated: Served) -> None:
    assert [each["user"] for each in (await populated.ask("GET", "/environments?user=*")).body["items"]] == ["ann"]
    theirs, nobodys = [await populated.ask("GET", f"/environments/other?user={user}") for user in ("bob", "nobody")]
    assert theirs.status == nobodys.status == 404
    assert theirs.body["detail"].replace("bob", "") == nobodys.body["detail"].replace("nobody", "")
    everybodys = (await populated.ask("GET", "/environments?user=*", "olga")).body["items"]
    assert [each["user"] for each in everybodys] == ["ann", "bob"]
    assert (await populated.ask("GET", "/environments/other?user=bob", "root")).body["user"] == "bob"
