"""HTTP server for the metrics of a bridge."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from typing import Any

import aiohttp
import pytest

from endpoints.bridge.metrics import metrics_application, serve_metrics
from rce.errors import Unavailable
from rce.process.metrics import Family, gauge_family
from rce.web.server import Endpoint, listen, serve_application


def families() -> list[Family]:
    return [gauge_family("rce_tested", "What this test counts", [], {(): 7.0})]


@pytest.fixture
async def url() -> AsyncIterator[str]:
    runner = serve_application(metrics_application(families))
    host, port = await listen(runner, Endpoint("127.0.0.1", 0))
    yield f"http://{host}:{port}"
    await runner.cleanup()


async def answer(method: str, url: str) -> tuple[int, str, str]:
    async with aiohttp.request(method, url) as response:
        return response.status, response.headers.get("Content-Type", ""), await response.text()


async def test_metrics_are_text_for_prometheus(url: str) -> None:
    status, content_type, text = await answer("GET", f"{url}/metrics")
    assert (status, content_type) == (200, "text/plain; version=0.0.4; charset=utf-8")
    assert "rce_tested 7.0" in text
    assert 'role="bridge"' in text, "metrics of the process name its role"


async def test_other_paths_and_methods_are_refused(url: str) -> None:
    assert (await answer("GET", f"{url}/"))[0] == 404
    assert (await answer("POST", f"{url}/metrics"))[0] == 405
    assert (await answer("HEAD", f"{url}/metrics"))[0] == 200


async def test_port_in_use_is_refused() -> None:
    with socket.create_server(("0.0.0.0", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(Unavailable, match=f"port {port} .* is in use"):
            async with serve_metrics(port, families):
                pytest.fail("the port is in use")


async def test_port_is_free_again_at_the_end() -> None:
    with socket.socket() as reservation:  # bound, but does not listen: a server with SO_REUSEADDR can bind its port
        reservation.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        reservation.bind(("0.0.0.0", 0))
        port = reservation.getsockname()[1]
        async with serve_metrics(port, families):
            assert (await answer("GET", f"http://127.0.0.1:{port}/metrics"))[0] == 200
        with socket.create_server(("0.0.0.0", port)):
            pass


async def test_nothing_listens_without_port(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        pytest.fail("a socket was bound")

    monkeypatch.setattr(socket, "create_server", refuse)
    async with serve_metrics(0, families):
        await asyncio.sleep(0)
