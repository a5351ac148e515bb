"""docs/api.md lists every path (`tests/e2e/test_api_examples.py` runs its examples)."""

from __future__ import annotations

from pathlib import Path

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
