"""`user`, `key`, `audit`."""

from __future__ import annotations

import json
import sys
import time
from datetime import datetime
from typing import Any

import pytest

from rce.api.client import ApiClient
from rce.api.roles import Scopes
from rce.api.views import AuditView, CreatedKey, KeyView, UsageView, UserView
from rce.cli.commands import accounts
from rce.cli.contexts import Access
from rce.cli.execute import FAILURE, SUCCESS
from tests.support.console import Console, Request, Terminal

KEY = KeyView("6f", "ann", "robot", "r2d2", 1e9, scopes=Scopes("r2", ["brain"]))
NOW = 1_900_000_000.0


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("user list", Request("GET users", {})),
        ("key list --of all", Request("GET keys", {"user": "*"})),
        ("audit", Request("GET audit", {"limit": 100})),
        (
            "audit --by ada --action key.create --object ada/k --result ok -n 5 --since 12.5",
            Request(
                "GET audit",
                {"user": "ada", "action": "key.create", "object": "ada/k", "result": "ok", "limit": 5, "since": 12.5},
            ),
        ),
    ],
)
def test_list_is_requested(line: str, expected: Request) -> None:
    assert Console([]).request(line) == expected


@pytest.mark.parametrize(("words", "name"), [("show", "ann"), ("show ada", "ada"), ("usage", "ann/usage")])
def test_user_is_oneself_unless_named(words: str, name: str) -> None:
    answer: object = UsageView(1, 2.0, 2**30, 0, 1, 4, 0) if "usage" in words else UserView("ada", "user", 1e9)
    assert Console(answer).request(f"user {words}").line == f"GET users/{name}"


def test_usage_is_printed_with_units(capsys: pytest.CaptureFixture[str]) -> None:
    Console(UsageView(1, 2.5, 2**30, 0, 1, 4, 2048)).request("user usage")
    fields = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert (fields["cores"], fields["total_memory"], fields["total_bandwidth"]) == ("2.5", "1 GiB", "0 B")


def test_user_is_added_with_a_role() -> None:
    body = {"name": "olga", "password": "a long password", "role": "operator"}
    made = Console().request("user add olga --role operator --password 'a long password'")
    assert made == Request("POST users", {}, body)


def test_password_of_a_new_user_is_asked_for_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    def read_password(prompt: str, repeat: bool = False) -> str:
        assert (prompt, repeat) == ("Password for olga: ", True)
        return "typed password"

    monkeypatch.setattr(accounts, "read_password", read_password)
    assert Console().request("user add olga").body["password"] == "typed password"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("user remove ada", Request("DELETE users/ada", {})),
        ("user role ada operator", Request("PATCH users/ada", {}, {"role": "operator"})),
        ("user passwd --new b --old a", Request("PUT users/ann/password", {}, {"new": "b", "old": "a"})),
        ("user passwd ada --new b", Request("PUT users/ada/password", {}, {"new": "b", "old": ""})),
        ("key revoke 6f --of eve", Request("DELETE keys/6f", {"user": "eve"})),
    ],
)
def test_change_is_sent(line: str, expected: Request) -> None:
    assert Console().request(line) == expected


@pytest.mark.parametrize(
    ("name", "prompts"), [("", ["Present password: ", "New password: "]), ("ada", ["New password: "])]
)
def test_present_password_is_asked_for_only_of_oneself(
    name: str, prompts: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def read_password(prompt: str, repeat: bool = False) -> str:
        asked.append(prompt)
        return prompt

    monkeypatch.setattr(accounts, "read_password", read_password)
    assert Console().request(f"user passwd {name}").body["new"] == "New password: "
    assert asked == prompts


@pytest.mark.parametrize(
    ("change", "sent"),
    [
        ("environments=4", {"environments": "4"}),
        ("total_memory=8GiB", {"total_memory": "8GiB"}),
        ("environments=", {"environments": ""}),
        ("environments=-", {"environments": "-"}),
        ("environments=0", {"environments": "0"}),
        ("images+=mine/*", {"images": ["rce/base", "mine/*"]}),
        ("images+=rce/base", {"images": ["rce/base"]}),
        ("groups+=a", {"groups": ["a"]}),
        ("images=a=b", {"images": "a=b"}),
    ],
)
def test_limit_is_changed(change: str, sent: dict[str, Any]) -> None:
    console = Console({"images": ["rce/base"]}, None, {"images": ["rce/base"]})
    assert console.run(f"user limits ada {change}") == SUCCESS
    assert [each.line for each in console.api.requests] == [
        "GET users/ada/limits",
        "PATCH users/ada/limits",
        "GET users/ada/limits",
    ]
    assert console.api.requests[1].body == sent


def test_change_without_a_value_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console({}).run("user limits ada environments") == FAILURE
    assert "'environments': write key=value" in capsys.readouterr().err


def test_no_limit_is_printed_as_a_dash_and_zero_as_zero(capsys: pytest.CaptureFixture[str]) -> None:
    limits = {"environments": 0, "total_memory": 0, "robots": None, "disk": None, "images": []}
    Console(limits).request("user limits")
    rows = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert rows == [["environments", "0"], ["total_memory", "0 B"], ["robots", "-"], ["disk", "-"], ["images", "none"]]
    Console(limits).request("user limits --json")
    assert json.loads(capsys.readouterr().out) == limits


def test_key_is_created_and_its_secret_printed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "time", lambda: NOW)
    line = "key create --label r2d2 --robot r2 --environment a --environment b --days 2 --of eve"
    scopes = {"robot": "r2", "environments": ["a", "b"]}
    body = {"role": "robot", "label": "r2d2", "expires": NOW + 2 * 86_400, "scopes": scopes}
    assert Console(CreatedKey("rce_s", KEY)).request(line) == Request("POST keys", {"user": "eve"}, body)
    assert capsys.readouterr().out == "rce_s\n"


def test_key_is_permanent_unless_days_are_given() -> None:
    assert Console(CreatedKey("rce_s", KEY)).request("key create --role user").body["expires"] is None


def test_created_key_in_json_has_its_id(capsys: pytest.CaptureFixture[str]) -> None:
    Console(CreatedKey("rce_s", KEY)).request("key create --json")
    printed = json.loads(capsys.readouterr().out)
    assert (printed["secret"], printed["key"]["id"]) == ("rce_s", "6f")


def test_rotated_key_prints_the_new_secret(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console(CreatedKey("rce_new", KEY)).request("key rotate 6f").line == "POST keys/6f/rotate"
    assert capsys.readouterr().out == "rce_new\n"


@pytest.mark.parametrize("words", ["create", "rotate 6f"])
@pytest.mark.parametrize(("answer", "used"), [("typed", ["typed"]), ("", [])])
def test_keys_are_made_with_the_password_if_there_is_one(
    words: str, answer: str, used: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    console, passwords = Console(CreatedKey("rce_s", KEY)), list[str]()
    console.session.__dict__["access"] = Access("http://127.0.0.1:1/", "ann", None, "rce_session")

    def client(url: str, *, user: str, password: str) -> ApiClient:
        assert (url, user) == ("http://127.0.0.1:1/", "ann")
        passwords.append(password)
        return console.session.api

    monkeypatch.setattr(accounts, "ApiClient", client)
    monkeypatch.setattr(sys, "stdin", Terminal())
    monkeypatch.setattr(accounts, "read_password", lambda prompt: answer)
    console.request(f"key {words}")
    assert passwords == used


def test_keys_are_listed_with_what_they_are_tied_to(capsys: pytest.CaptureFixture[str]) -> None:
    Console([KEY]).request("key list")
    cells = capsys.readouterr().out.splitlines()[1].split()
    assert cells == ["6f", "ann", "robot", "r2d2", "never", "never", "r2", "brain"]


def test_audit_log_names_the_interface_of_an_action(capsys: pytest.CaptureFixture[str]) -> None:
    Console([AuditView(1, NOW, "ann", "6f", "env.create", "ann/a", "ok", "rest", "10.0.0.1")]).request("audit")
    assert capsys.readouterr().out.splitlines()[1].split()[2:] == [
        "ann",
        "env.create",
        "ann/a",
        "ok",
        "rest",
        "10.0.0.1",
    ]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1900000000", NOW),
        ("1.5", 1.5),
        ("2030-01-31T08:00", datetime(2030, 1, 31, 8).timestamp()),
        ("2030-01-31T08:00:00+00:00", 1_896_076_800.0),
    ],
)
def test_time_is_a_date_or_seconds(text: str, seconds: float) -> None:
    assert Console([]).request(f"audit --until {text}").query["until"] == seconds


@pytest.mark.parametrize("text", ["yesterday", "1.2.3", "31.1.2030", "."])
def test_other_times_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert Console([]).run(f"audit --since {text}") == FAILURE
    assert f"'{text}' is not a time" in capsys.readouterr().err
