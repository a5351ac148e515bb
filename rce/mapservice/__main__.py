"""`python -P -m rce.mapservice`: the map service."""

from __future__ import annotations

import sys
from typing import Annotated

from msgspec import Meta
from twisted.internet.base import ReactorBase

from rce.control.credential import stay_joined
from rce.mapservice.job_runner import JobRunner
from rce.mapservice.jobs import JobLimits
from rce.mapservice.server import MapService, MapServiceLimits
from rce.mapservice.uploads import UploadLimits
from rce.services import program
from rce.services.program import GIGABYTE, Port, ServiceSettings

HOUR, DAY = 3600.0, 86_400.0
NAME = "map-service"  # the Master finds the service by this name


class Settings(ServiceSettings):
    """Map service: accepts recordings, maps them in environments of their users, and keeps the results."""

    entry: Annotated[str, Meta(description="URL of the robots' HTTP entry, at which jobs connect to the platform")] = (
        "http://127.0.0.1:9000/"
    )
    trust: Annotated[
        str, Meta(description="PEM file with the platform's own certificate, if no public CA has issued it")
    ] = ""
    port: Port = 9040
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
    service = MapService(options.directory(), lambda: link, JobRunner(max_time), limits, options.entry, options.trust)
    link, credential = await program.start(reactor, options, NAME, service)
    service.jobs.start()
    try:
        await stay_joined(link, credential)
    finally:
        await service.stop()


def main() -> int:
    """Run the program and return its exit status."""
    return program.run("rce map-service", Settings, serve)


if __name__ == "__main__":
    sys.exit(main())
