"""docs/api.md lists every path, and its examples run."""

from __future__ import annotations

import asyncio
import re
import shutil
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from master.api.resources import make_api
from master.storage.depot import Depot
from tests.support.master.served import serve
from tests.support.paths import ROOT

DOCUMENT = ROOT / "docs" / "api.md"


def table(routes: list[tuple[str, str, str]]) -> str:
    """Return the table of paths in the document."""
    rows = [f"| `{method}` | `{path}` | {summary} |" for method, path, summary in routes]
    return "\n".join(["| method | path | |", "|---|---|---|", *rows])


async def test_document_lists_every_path(reactor: ReactorBase, tmp_path: Path) -> None:
    async with serve(reactor, tmp_path) as served:
        api = make_api(served.master, Depot(tmp_path / "another"))
    routes = [(route.method, route.path, route.summary) for route in api.routes]
    routes.append(("GET", "/live", "WebSocket with the changes of the graph"))
    assert table(sorted(routes, key=lambda route: route[1])) in DOCUMENT.read_text()


async def test_examples_run(reactor: ReactorBase, tmp_path: Path) -> None:
    if shutil.which("curl") is None:
        pytest.skip("needs curl")
    script = re.findall(r"```sh\n(.*?)```", DOCUMENT.read_text(), re.S)[0]
    async with serve(reactor, tmp_path) as served:
        await served.robot("olga", "r1")
        secret, _ = await served.master.users.keys.add("olga", "operator")
        bash = await asyncio.create_subprocess_exec(
            *("bash", "-euo", "pipefail", "-c", script),
            env={"PATH": "/usr/bin:/bin", "URL": served.url, "KEY": secret},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        output, _ = await asyncio.wait_for(bash.communicate(), 60)
        assert bash.returncode == 0, output.decode()
        assert not list(served.master.state.environments)
        assert not list(served.master.state.robots)
