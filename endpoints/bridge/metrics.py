"""`/metrics` of a bridge: on a robot there is no Master to ask for them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.web.resource import Resource
from twisted.web.server import Request, Site

from rce.errors import no_port
from rce.exposition import CONTENT_TYPE, text
from rce.metrics import Source, families


class _Metrics(Resource):
    isLeaf = True

    def __init__(self, source: Source) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._source = source

    def render_GET(self, request: Request) -> bytes:
        request.setHeader("content-type", CONTENT_TYPE)
        return text(families("bridge", self._source))


@contextlib.contextmanager
def told(reactor: ReactorBase, port: int, source: Source) -> Iterator[None]:
    """Tell whoever asks at this port, on all addresses; 0: nobody. Unavailable."""
    if not port:
        yield
        return
    root = Resource()
    root.putChild(b"metrics", _Metrics(source))  # type: ignore[arg-type]  # zope declares its methods without self
    try:
        listening = reactor.listenTCP(port, Site(root))  # type: ignore[attr-defined]  # of IReactorTCP
    except CannotListenError as error:
        raise no_port("", port, error.socketError) from None
    try:
        yield
    finally:
        listening.stopListening()
