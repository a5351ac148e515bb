"""`python -P -m rce.knowledge`: the knowledge service."""

from __future__ import annotations

import sys
from typing import Annotated

from msgspec import Meta
from twisted.internet.base import ReactorBase

from rce.control.calls.knowledge import SERVICE
from rce.control.credential import stay_joined
from rce.knowledge.queries import QueryLimits
from rce.knowledge.repository import RepositoryLimits
from rce.knowledge.server import KnowledgeLimits, KnowledgeService
from rce.services import program
from rce.services.program import GIGABYTE, MEGABYTE, Port, ServiceSettings


class Settings(ServiceSettings):
    """Knowledge service: keeps action recipes, objects and environments that robots share."""

    port: Port = 9050
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
    limits = KnowledgeLimits(
        RepositoryLimits(
            int(options.file_size * MEGABYTE), int(options.quota * GIGABYTE), int(options.spare * GIGABYTE)
        ),
        QueryLimits(options.query_time, options.query_memory * MEGABYTE, workers=options.query_workers),
    )
    service = KnowledgeService(options.directory(), lambda: link, limits, options.anonymous)
    link, credential = await program.start(reactor, options, SERVICE, service)
    try:
        await stay_joined(link, credential)
    finally:
        await service.stop()


def main() -> int:
    """Run the program and return its exit status."""
    return program.run("rce knowledge-service", Settings, serve)


if __name__ == "__main__":
    sys.exit(main())
