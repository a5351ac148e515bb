"""HTTP server for the metrics of a bridge, which no Master collects."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.web.resource import Resource
from twisted.web.server import Request, Site

from rce.errors import port_unavailable
from rce.process.exposition import CONTENT_TYPE, prometheus_text
from rce.process.metrics import Source, collect_families


class _Metrics(Resource):
    isLeaf = True

    def __init__(self, source: Source) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._source = source

    def render_GET(self, request: Request) -> bytes:
        request.setHeader("content-type", CONTENT_TYPE)
        return prometheus_text(collect_families("bridge", self._source))


@contextlib.contextmanager
def serve_metrics(reactor: ReactorBase, port: int, source: Source) -> Iterator[None]:
    """Serve `/metrics` at a port on all addresses; 0 for none.

    Raises:
        Unavailable: The port cannot be bound.
    """
    if not port:
        yield
        return
    root = Resource()
    root.putChild(b"metrics", _Metrics(source))  # type: ignore[arg-type]  # zope declares its methods without self
    try:
        listening = reactor.listenTCP(port, Site(root))  # type: ignore[attr-defined]  # of IReactorTCP
    except CannotListenError as error:
        raise port_unavailable("", port, error.socketError) from None
    try:
        yield
    finally:
        listening.stopListening()
