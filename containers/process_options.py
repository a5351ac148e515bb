"""Which options of an environment the process engine takes.

It enforces none of those that bound what an environment uses: they are taken with a warning, so that what runs in
containers elsewhere runs here too. What changes what an environment is, an image or a network group, is refused.
RLIMIT_AS would break Fast DDS, whose shared memory counts as address space.
"""

from __future__ import annotations

from twisted.logger import Logger

from containers.limits import Size, check
from rce.calls.environments import EnvironmentSpec
from rce.errors import InvalidRequest
from rce.messages import ContainerData, Rates

log = Logger()


def check_options(spec: EnvironmentSpec) -> None:
    """LimitExceeded for more than the machine has, InvalidRequest for what this engine does not have at all."""
    options: ContainerData = spec.options
    check(spec, Size.here())
    for field in ("image", "gpus"):
        if getattr(options, field):
            raise InvalidRequest(
                f"environment {spec.name}: the process engine has no {field}; use docker or swarm",
                field=f"containerData.{field}",
            )
    ignored = [name for name in ("cpu", "memory", "pids", "disk", "bandwidth") if getattr(options, name)]
    ignored += ["io"] if options.io != Rates() else []
    if ignored:
        log.warn("{name}: the process engine does not enforce {options}", name=spec.name, options=", ".join(ignored))
