"""`rce package`."""

from __future__ import annotations

import pytest

from rce.cli.execute import FAILURE, SUCCESS
from tests.support.console import login, rce
from tests.support.master.served import Served


async def test_package_uses_the_current_context_unless_given_an_address(
    served: Served, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    await login(served.url, "ann", "home")
    monkeypatch.delenv("RCE_PASSWORD")
    assert await rce("package", "list", "--json") == SUCCESS
    assert capsys.readouterr().out.splitlines()[-1] == "[]"
    assert await rce("package", "list", "--url", served.url) == FAILURE
