"""`env`, `node`, `param`."""

from __future__ import annotations

import json

import pytest

from tests.support.console import login, rce
from tests.support.master.served import Served


async def test_json_output_is_the_response_of_the_api(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served.url, "ann", "home")
    await rce("env", "create", "brain", "--memory", "1.5GiB", "--env", "A=b=c")
    await rce("param", "set", "brain", "frames", "[map, odom]")
    capsys.readouterr()
    await rce("env", "show", "brain", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed == (await served.ask("GET", "/environments/brain")).body
    assert (printed["containerData"]["memory"], printed["containerData"]["env"]) == (3 * 2**29, {"A": "b=c"})
    await rce("param", "get", "brain", "frames")
    assert capsys.readouterr().out == "[map, odom]\n"
