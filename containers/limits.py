"""Which options of an environment the process engine takes.

It enforces none of them. `cpu`, `memory` and `bandwidth` are taken with a warning, so that what runs in containers
elsewhere runs here too. RLIMIT_AS would break Fast DDS, whose shared memory counts as address space.
"""

from __future__ import annotations

import os

from twisted.logger import Logger

from rce.calls import EnvironmentSpec
from rce.errors import InvalidRequest, LimitExceeded
from rce.messages import ContainerData

log = Logger()


def check_limits(spec: EnvironmentSpec) -> None:
    """LimitExceeded for more than the machine has, InvalidRequest for what this engine does not have at all."""
    options: ContainerData = spec.options
    machine = {"cpu": float(os.cpu_count() or 1), "memory": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")}
    for field, limit in machine.items():
        asked = getattr(options, field)
        if asked > limit:
            raise LimitExceeded(
                f"environment {spec.name} asks for {field} {asked:g}, this machine has {limit:g}",
                field=f"containerData.{field}",
                asked=asked,
                limit=limit,
            )
    if options.group:
        raise InvalidRequest(
            f"environment {spec.name}: the process engine has no network groups; use docker or swarm",
            field="containerData.group",
        )
    if options.cpu or options.memory or options.bandwidth:
        log.warn("{name}: the process engine does not enforce cpu, memory and bandwidth", name=spec.name)
