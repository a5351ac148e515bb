"""Secrets over HTTP: they are written and never read, and reach the environment alone."""

from __future__ import annotations

from rce.control.calls.endpoints import PutSecrets
from tests.support.master.served import Served

SECRET = {"name": "database", "value": "hidden"}


async def test_secret_is_set_listed_and_removed_but_not_shown(served: Served) -> None:
    assert (await served.ask("POST", "/secrets", "ann", SECRET)).status == 201
    listed = await served.ask("GET", "/secrets", "ann")
    assert [each["name"] for each in listed.body["items"]] == ["database"]
    assert (await served.ask("GET", "/secrets", "bob")).body["items"] == []
    assert "hidden" not in str(listed.body)
    assert "hidden" not in str(served.master.state.secrets["ann/database"])
    assert (await served.ask("DELETE", "/secrets/database", "bob")).status == 404
    assert (await served.ask("DELETE", "/secrets/database", "ann")).status == 204


async def test_environment_gets_the_value_and_its_view_the_name(served: Served) -> None:
    await served.ask("POST", "/secrets", "ann", SECRET)
    body = {"containerTag": "safe", "containerData": {"secrets": {"database": "PASSWORD"}}}
    made = await served.ask("POST", "/environments", "ann", body)
    assert made.body["containerData"]["secrets"] == {"database": "PASSWORD"}
    (call,) = [call for call in served.peers["ann/safe"].calls if isinstance(call, PutSecrets)]
    assert (call.secrets["database"].variable, call.secrets["database"].value) == ("PASSWORD", "hidden")
    assert "hidden" not in repr(call)
    audit = await served.ask("GET", "/audit?limit=1000", "root")
    assert "secret.set" in str(audit.body)
    assert "hidden" not in str(audit.body)


async def test_missing_secret_is_refused_and_wrong_values_too(served: Served) -> None:
    body = {"containerTag": "safe", "containerData": {"secrets": {"database": ""}}}
    refused = await served.ask("POST", "/environments", "ann", body)
    assert (refused.status, refused.body["field"]) == (404, "containerData.secrets")
    for value in ("", "a\0b", "x" * 40_000):
        assert (await served.ask("POST", "/secrets", "ann", SECRET | {"value": value})).status == 400
