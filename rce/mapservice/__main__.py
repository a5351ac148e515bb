"""`python -P -m rce.mapservice`: the map service."""

from __future__ import annotations

import os
import secrets
import sys
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase

import rce
from rce import loop, settings
from rce.calls.joining import Hello, Welcome
from rce.control import MasterLink
from rce.credential import Credential, stay_joined
from rce.host import host_identity
from rce.mapservice import jobs, uploads
from rce.mapservice.server import Limits, MapService
from rce.mapservice.worker import Worker
from rce.ready import Ready, announce
from rce.tls import load, public

GIGABYTE = 1024**3
HOUR, DAY = 3600.0, 86_400.0
NAME = "map-service"  # the Master redirects by it


class Settings(Struct):
    """The map service: takes recordings, has maps made of them in environments of their users, keeps the results."""

    data_dir: Annotated[Path, Meta(description="directory for uploads, jobs and the credential")]
    master: Annotated[str, Meta(description="Twisted client endpoint of the Master's control port")] = (
        "tcp:127.0.0.1:8080"
    )
    entry: Annotated[str, Meta(description="the robots' entry, by which jobs enter the platform")] = (
        "http://127.0.0.1:9000/"
    )
    trust: Annotated[str, Meta(description="PEM file with the platform's own certificate, if it has one")] = ""
    token: Annotated[str, Meta(description="one-time join token; better given as RCE_TOKEN")] = ""
    tls: Annotated[Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem, for the Master")] = None
    host: Annotated[str, Meta(description="address on which clients are served")] = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535, description="port for clients; 0 takes a free one")] = 9020
    public_url: Annotated[str, Meta(description="where the Master sends clients; else the host of their request")] = ""
    certificate: Annotated[str, Meta(description="PEM file for https")] = ""
    private_key: Annotated[str, Meta(description="PEM file of its key")] = ""
    at_once: Annotated[int, Meta(ge=1, description="jobs that run at once")] = 4
    per_user: Annotated[int, Meta(ge=1, description="of them, jobs of one user")] = 1
    queued: Annotated[int, Meta(ge=1, description="jobs of one user that may wait")] = 50
    longest: Annotated[float, Meta(gt=0, description="hours that a job may run")] = 12
    recording_size: Annotated[float, Meta(gt=0, description="largest file in GB")] = 16
    quota: Annotated[float, Meta(gt=0, description="GB of recordings and results that one user may have here")] = 32
    spare: Annotated[float, Meta(ge=0, description="GB of the disk that stay free")] = 2
    keep_recordings: Annotated[float, Meta(gt=0, description="days after its last use that a recording is kept")] = 3
    keep_results: Annotated[float, Meta(gt=0, description="days that a result is kept")] = 30


async def serve(reactor: ReactorBase, options: Settings) -> None:
    """Run until cancelled, or until the Master refuses this service."""
    directory = options.data_dir.expanduser().absolute()
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    credential = Credential(directory / "credential", options.token)
    longest = options.longest * HOUR
    limits = Limits(
        uploads.Limits(
            int(options.recording_size * GIGABYTE),
            int(options.quota * GIGABYTE),
            int(options.spare * GIGABYTE),
            options.keep_recordings * DAY,
        ),
        jobs.Limits(options.at_once, options.per_user, options.queued, options.keep_results * DAY, longest),
    )
    service = MapService(directory, lambda: link, Worker(longest), limits, options.entry, options.trust)
    scheme = "https" if options.certificate else "http"
    port = await service.start(options.host, options.port, public(options.certificate, options.private_key))
    url = options.public_url or f"{scheme}://:{port}/"
    incarnation = secrets.token_hex(16)

    def hello() -> Hello:
        return Hello("service", NAME, credential.secret, rce.__version__, incarnation, host_identity(), url=url)

    def welcomed(welcome: Welcome) -> None:
        credential.keep(welcome)
        announce(Ready(NAME, url))

    link = MasterLink(reactor, options.master, hello, service.handlers(), welcomed, load(options.tls))
    service.jobs.start()
    try:
        await stay_joined(link, credential)
    finally:
        await service.stop()


def main() -> int:
    options = settings.load_or_exit(Settings, "rce map-service")
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: serve(reactor, options))


if __name__ == "__main__":
    sys.exit(main())
