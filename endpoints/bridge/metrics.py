"""HTTP server for the metrics of a bridge, which no Master collects."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

from aiohttp import hdrs, web

from rce.process.exposition import CONTENT_TYPE, prometheus_text
from rce.process.metrics import Source, collect_families
from rce.web.server import Endpoint, listen, serve_application

ALL_ADDRESSES = "0.0.0.0"


def metrics_application(source: Source) -> web.Application:
    """Return the application that answers `/metrics` with the families of `source` and those of the process."""

    async def metrics(_: web.Request) -> web.Response:
        text = prometheus_text(collect_families("bridge", source))
        return web.Response(body=text, headers={hdrs.CONTENT_TYPE: CONTENT_TYPE})

    application = web.Application()
    application.router.add_get("/metrics", metrics)
    return application


@contextlib.asynccontextmanager
async def serve_metrics(port: int, source: Source) -> AsyncIterator[None]:
    """Serve `/metrics` at a port on all addresses; 0 for none. At the end the port is free again.

    Raises:
        Unavailable: The port cannot be bound.
    """
    if not port:
        yield
        return
    runner = serve_application(metrics_application(source))
    try:
        await listen(runner, Endpoint(ALL_ADDRESSES, port))
        yield
    finally:
        await runner.cleanup()
