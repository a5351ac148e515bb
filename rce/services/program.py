"""Program of a service: the settings of all services, and how one starts and joins the platform."""

from __future__ import annotations

import os
import ssl
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Annotated, Protocol, TypeVar

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase

from rce.control.client import ControlClient
from rce.control.connection import Handlers
from rce.control.credential import Credential
from rce.net.tls import load_tls, public_tls_context
from rce.process import loop, settings
from rce.services.link import link_to_master

MEGABYTE, GIGABYTE = 1024**2, 1024**3
Port = Annotated[int, Meta(ge=0, le=65535, description="port for clients; 0 for a free one")]


class ServiceSettings(Struct):
    """Settings that every service has. Each adds its own, and the default of its port."""

    data_dir: Annotated[Path, Meta(description="directory for what the service keeps, and for its credential")]
    master: Annotated[
        str, Meta(description="Twisted client endpoint of the Master's control port; of several: comma-separated")
    ] = "tcp:127.0.0.1:8080"
    token: Annotated[str, Meta(description="one-time join token; better given as RCE_TOKEN")] = ""
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem for the connection to the Master")
    ] = None
    host: Annotated[str, Meta(description="address on which to listen for clients")] = "127.0.0.1"
    port: Port = 0
    public_url: Annotated[
        str, Meta(description="URL to which the Master redirects clients; by default with the host of their request")
    ] = ""
    certificate: Annotated[str, Meta(description="PEM file for https")] = ""
    private_key: Annotated[str, Meta(description="PEM file of its key")] = ""

    def directory(self) -> Path:
        """Return the absolute path of `data_dir`, which is created for this user only."""
        directory = self.data_dir.expanduser().absolute()
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        return directory


S = TypeVar("S", bound=ServiceSettings)


class Service(Protocol):
    """A service that has not started yet."""

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None) -> int:
        """Listen for clients; return the port."""

    def handlers(self) -> Handlers:
        """Return the handlers for the Master's calls."""

    async def stop(self) -> None:
        """End its work."""


async def start(
    reactor: ReactorBase, options: ServiceSettings, name: str, service: Service
) -> tuple[ControlClient, Credential]:
    """Let a service listen for clients; return its connection to the Master, which has not joined yet.

    Args:
        reactor: Twisted's reactor.
        options: Settings of the service.
        name: Name by which the Master finds the service.
        service: The service.

    Raises:
        RceError: The port is in use, or a certificate cannot be used.
    """
    credential = Credential(options.directory() / "credential", options.token)
    tls = load_tls(options.tls)
    scheme = "https" if options.certificate else "http"
    port = await service.start(options.host, options.port, public_tls_context(options.certificate, options.private_key))
    url = options.public_url or f"{scheme}://:{port}/"
    return link_to_master(reactor, options.master, name, url, credential, service.handlers(), tls), credential


def run(program: str, kind: type[S], serve: Callable[[ReactorBase, S], Coroutine[None, None, None]]) -> int:
    """Load the settings, serve until a signal comes, and return the exit status."""
    options = settings.load_or_exit(kind, program)
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: serve(reactor, options))
