"""`python -P -m rce.knowledge`: the knowledge service."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase

from rce.control.calls.knowledge import SERVICE
from rce.control.credential import Credential, stay_joined
from rce.knowledge.queries import QueryLimits
from rce.knowledge.repository import RepositoryLimits
from rce.knowledge.server import KnowledgeLimits, KnowledgeService
from rce.net.tls import load_tls, public_tls_context
from rce.process import loop, settings
from rce.services.link import link_to_master

MEGABYTE, GIGABYTE = 1024**2, 1024**3


class Settings(Struct):
    """Knowledge service: keeps action recipes, objects and environments that robots share."""

    data_dir: Annotated[Path, Meta(description="directory for the repository and the credential")]
    master: Annotated[
        str, Meta(description="Twisted client endpoint of the Master's control port; of several: comma-separated")
    ] = "tcp:127.0.0.1:8080"
    token: Annotated[str, Meta(description="one-time join token; better given as RCE_TOKEN")] = ""
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem for the connection to the Master")
    ] = None
    host: Annotated[str, Meta(description="address on which to listen for clients")] = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535, description="port for clients; 0 for a free one")] = 9050
    public_url: Annotated[
        str, Meta(description="URL to which the Master redirects clients; by default with the host of their request")
    ] = ""
    certificate: Annotated[str, Meta(description="PEM file for https")] = ""
    private_key: Annotated[str, Meta(description="PEM file of its key")] = ""
    anonymous: Annotated[bool, Meta(description="let clients without credentials read what is public")] = False
    file_size: Annotated[float, Meta(gt=0, description="maximum size of a file, and of an archive, in MB")] = 1024
    quota: Annotated[float, Meta(gt=0, description="quota of one user for all versions of all entries, in GB")] = 4
    spare: Annotated[float, Meta(ge=0, description="disk space that stays free, in GB")] = 1
    query_time: Annotated[float, Meta(gt=0, le=600, description="maximum time of a query in seconds")] = 10
    query_memory: Annotated[int, Meta(ge=16, description="memory that a query may allocate, in MB")] = 512
    query_workers: Annotated[int, Meta(ge=1, description="maximum number of users whose queries run at once")] = 4


async def serve(reactor: ReactorBase, options: Settings) -> None:
    """Run the knowledge service until cancelled.

    Raises:
        RceError: The Master refuses this service, or the port is in use.
    """
    directory = options.data_dir.expanduser().absolute()
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    credential = Credential(directory / "credential", options.token)
    limits = KnowledgeLimits(
        RepositoryLimits(
            int(options.file_size * MEGABYTE), int(options.quota * GIGABYTE), int(options.spare * GIGABYTE)
        ),
        QueryLimits(options.query_time, options.query_memory * MEGABYTE, workers=options.query_workers),
    )
    service = KnowledgeService(directory, lambda: link, limits, options.anonymous)
    scheme = "https" if options.certificate else "http"
    port = await service.start(options.host, options.port, public_tls_context(options.certificate, options.private_key))
    url = options.public_url or f"{scheme}://:{port}/"
    tls = load_tls(options.tls)
    link = link_to_master(reactor, options.master, SERVICE, url, credential, service.handlers(), tls)
    try:
        await stay_joined(link, credential)
    finally:
        await service.stop()


def main() -> int:
    """Run the program and return its exit status."""
    options = settings.load_or_exit(Settings, "rce knowledge-service")
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: serve(reactor, options))


if __name__ == "__main__":
    sys.exit(main())
