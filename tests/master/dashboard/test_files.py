"""Files of the dashboard, their headers, and the redirect of browsers from the entry."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import http.client
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from master.dashboard import FOLDERS, load_files
from rce.protocol.messages import CURRENT_VERSION
from tests.support.master.fleet import Fleet
from tests.support.master.served import serve_entry

Ask = Callable[..., Awaitable[http.client.HTTPResponse]]


@pytest.fixture
async def ask(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Ask]:
    fleet = Fleet()
    fleet.join("west", "robot", url="ws://:9010/")
    fleet.join("east", "robot", url="wss://robots.example:9443/")
    fleet.join("map-service", "service", url="http://:9020/")
    async with serve_entry(fleet.state, tmp_path) as port:

        def request(path: str, method: str = "GET", **headers: str) -> http.client.HTTPResponse:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
            connection.request(method, path, headers={"Connection": "close", **headers})
            return connection.getresponse()

        yield lambda path, method="GET", **headers: asyncio.to_thread(request, path, method, **headers)


async def test_pages_may_connect_to_this_master_robot_endpoints_and_services_only(ask: Ask) -> None:
    page = await ask("/ui/", Host="here.example:9000")
    assert (page.status, page.getheader("content-type")) == (200, "text/html; charset=utf-8")
    assert page.getheader("x-content-type-options") == "nosniff"
    policy = dict(part.split(" ", 1) for part in (page.getheader("content-security-policy") or "").split("; "))
    assert policy["default-src"] == "'self'"
    script = re.findall(r"<script>(.*?)</script>", page.read().decode(), re.DOTALL)[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy["script-src"] == f"'self' 'sha256-{digest}'"
    assert set(policy["connect-src"].split()) == {
        "'self'",
        "ws://here.example:9000",
        "ws://here.example:9010",
        "wss://robots.example:9443",
        "http://here.example:9020",
    }
    odd = await ask("/ui/", Host="x; script-src *")
    assert "*" not in (odd.getheader("content-security-policy") or "*")


async def test_unchanged_file_is_not_sent_again(ask: Ask) -> None:
    first = await ask("/ui/rce/rce.js")
    assert first.status == 200
    assert first.getheader("content-type") == "text/javascript; charset=utf-8"
    tag = first.getheader("etag") or ""
    assert len(first.read()) > 1000
    again = await ask("/ui/rce/rce.js", **{"If-None-Match": tag})
    assert (again.status, again.read()) == (304, b"")


async def test_only_get_and_head_are_allowed(ask: Ask) -> None:
    assert (await ask("/ui/main.js", "HEAD")).status == 200
    for method in ("POST", "DELETE"):
        answer = await ask("/ui/main.js", method)
        assert (answer.status, answer.getheader("allow")) == (405, "GET, HEAD")


async def test_files_outside_the_folders_are_not_served(ask: Ask) -> None:
    for path in ("/ui/../__init__.py", "/ui/%2e%2e/__init__.py", "/ui/__init__.py", "/ui/nothing.js"):
        assert (await ask(path)).status == 404, path


async def test_browser_at_the_bare_entry_is_redirected_to_the_dashboard_and_a_robot_is_not(ask: Ask) -> None:
    html = {"Accept": "text/html,application/xhtml+xml"}
    led = await ask("/", **html)
    assert (led.status, led.getheader("location")) == (302, "/ui/")
    assert (await ask("/ui")).status == 302
    assert (await ask("/")).status == 400
    assert (await ask("/?userID=ann", **html)).status == 400
    assert (await ask(f"/?userID=ann&version={CURRENT_VERSION}", **html)).status == 200


def test_pages_have_no_inline_handlers_or_styles_and_name_no_other_host() -> None:
    own = {name: file for name, file in load_files().items() if not name.startswith("vendor/")}
    for name, file in own.items():
        text = file.body.decode()
        assert not re.search(r"https?://(?!www\.w3\.org/)\w", text), name
        if name.endswith(".html"):
            assert not re.search(r"<style|\sstyle=|\son\w+=|<script(?!>|[^>]* src=)", text), name


def test_every_imported_module_exists() -> None:
    for folder in FOLDERS.values():
        for path in folder.rglob("*.js"):
            for name in re.findall(r'from "(\.[^"]+)"', path.read_text()):
                target = (path.parent / name).resolve()
                if "/rce/" in name and not target.exists():
                    target = FOLDERS["rce/"] / Path(name).name
                assert target.exists(), f"{path.name} imports {name}"
