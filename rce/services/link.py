"""Connection of a service to the Master."""

from __future__ import annotations

import secrets

from twisted.internet.base import ReactorBase

import rce
from rce.control.calls.joining import Hello, Welcome
from rce.control.client import ControlClient
from rce.control.connection import Handlers
from rce.control.credential import Credential
from rce.net.tls import Tls
from rce.process.host import host_identity
from rce.process.ready import Ready, announce


def link_to_master(
    reactor: ReactorBase,
    master: str,
    name: str,
    url: str,
    credential: Credential,
    handlers: Handlers,
    tls: Tls | None,
) -> ControlClient:
    """Return the connection by which a service joins; once it has joined it announces that it is ready.

    Args:
        reactor: Twisted's reactor.
        master: The Master's Twisted client endpoint.
        name: Name by which the Master finds the service.
        url: URL for clients.
        credential: Join token and credential of the service.
        handlers: Handlers for the Master's calls.
        tls: Certificates of this machine.
    """
    incarnation = secrets.token_hex(16)

    def hello() -> Hello:
        secret, version = credential.secret, rce.__version__
        host, own = host_identity(), credential.own
        return Hello("service", name, secret, version, incarnation, host, url=url, credential=own)

    def welcomed(welcome: Welcome) -> None:
        credential.keep(welcome)
        announce(Ready(name, url))

    return ControlClient(reactor, master, hello, handlers, welcomed, tls)
