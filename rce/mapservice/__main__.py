"""`python -P -m rce.mapservice`: the map service."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase

from rce.control.credential import Credential, stay_joined
from rce.mapservice.job_runner import JobRunner
from rce.mapservice.jobs import JobLimits
from rce.mapservice.server import MapService, MapServiceLimits
from rce.mapservice.uploads import UploadLimits
from rce.net.tls import load_tls, public_tls_context
from rce.process import loop, settings
from rce.services.link import link_to_master

GIGABYTE = 1024**3
HOUR, DAY = 3600.0, 86_400.0
NAME = "map-service"  # the Master finds the service by this name


class Settings(Struct):
    """Map service: accepts recordings, maps them in environments of their users, and keeps the results."""

    data_dir: Annotated[Path, Meta(description="directory for uploads, jobs and the credential")]
    master: Annotated[
        str, Meta(description="Twisted client endpoint of the Master's control port; of several: comma-separated")
    ] = "tcp:127.0.0.1:8080"
    entry: Annotated[str, Meta(description="URL of the robots' HTTP entry, at which jobs connect to the platform")] = (
        "http://127.0.0.1:9000/"
    )
    trust: Annotated[
        str, Meta(description="PEM file with the platform's own certificate, if no public CA has issued it")
    ] = ""
    token: Annotated[str, Meta(description="one-time join token; better given as RCE_TOKEN")] = ""
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem for the connection to the Master")
    ] = None
    host: Annotated[str, Meta(description="address on which to listen for clients")] = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535, description="port for clients; 0 for a free one")] = 9040
    public_url: Annotated[
        str, Meta(description="URL to which the Master redirects clients; by default with the host of their request")
    ] = ""
    certificate: Annotated[str, Meta(description="PEM file for https")] = ""
    private_key: Annotated[str, Meta(description="PEM file of its key")] = ""
    at_once: Annotated[int, Meta(ge=1, description="maximum number of running jobs")] = 4
    per_user: Annotated[int, Meta(ge=1, description="maximum number of running jobs of one user")] = 1
    queued: Annotated[int, Meta(ge=1, description="maximum number of waiting jobs of one user")] = 50
    longest: Annotated[float, Meta(gt=0, description="maximum time of a job in hours")] = 12
    recording_size: Annotated[float, Meta(gt=0, description="maximum size of a file in GB")] = 16
    quota: Annotated[float, Meta(gt=0, description="quota of one user for recordings and results, in GB")] = 32
    spare: Annotated[float, Meta(ge=0, description="disk space that stays free, in GB")] = 2
    keep_recordings: Annotated[float, Meta(gt=0, description="days that a recording is kept after its last use")] = 3
    keep_results: Annotated[float, Meta(gt=0, description="days that a result is kept")] = 30


async def serve(reactor: ReactorBase, options: Settings) -> None:
    """Run the map service until cancelled.

    Raises:
        RceError: The Master refuses this service, or the port is in use.
    """
    directory = options.data_dir.expanduser().absolute()
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    credential = Credential(directory / "credential", options.token)
    max_time = options.longest * HOUR
    limits = MapServiceLimits(
        UploadLimits(
            int(options.recording_size * GIGABYTE),
            int(options.quota * GIGABYTE),
            int(options.spare * GIGABYTE),
            options.keep_recordings * DAY,
        ),
        JobLimits(options.at_once, options.per_user, options.queued, options.keep_results * DAY, max_time),
    )
    service = MapService(directory, lambda: link, JobRunner(max_time), limits, options.entry, options.trust)
    scheme = "https" if options.certificate else "http"
    port = await service.start(options.host, options.port, public_tls_context(options.certificate, options.private_key))
    url = options.public_url or f"{scheme}://:{port}/"
    tls = load_tls(options.tls)
    link = link_to_master(reactor, options.master, NAME, url, credential, service.handlers(), tls)
    service.jobs.start()
    try:
        await stay_joined(link, credential)
    finally:
        await service.stop()


def main() -> int:
    """Run the program and return its exit status."""
    options = settings.load_or_exit(Settings, "rce map-service")
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: serve(reactor, options))


if __name__ == "__main__":
    sys.exit(main())
