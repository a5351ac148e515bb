"""Options of environments that the process engine accepts.

It accepts limits that it cannot enforce with a warning, so that environments for other engines run here too. It refuses
images and GPUs, without which an environment could not do its work. RLIMIT_AS is not used, because it would break Fast
DDS, whose shared memory counts as address space.
"""

from __future__ import annotations

from collections.abc import Collection

from twisted.logger import Logger

from containers.limits import Size, check
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import InvalidRequest
from rce.protocol.messages import ContainerData, Rates

log = Logger()
NEVER_ENFORCED = ("bandwidth", "disk", "egress", "io")


def check_options(spec: EnvironmentSpec, not_enforced: Collection[str]) -> None:
    """Check the options of an environment and warn of those that are not enforced.

    Args:
        spec: The environment.
        not_enforced: Options that have no effect on this machine.

    Raises:
        LimitExceeded: It asks for more than the machine has.
        InvalidRequest: It needs an image or GPUs.
    """
    options: ContainerData = spec.options
    check(spec, Size.here())
    for field in ("image", "gpus"):
        if getattr(options, field):
            raise InvalidRequest(
                f"environment {spec.name}: the process engine does not support {field}; use docker or swarm",
                field=f"containerData.{field}",
            )
    asked = {name for name in ("cpu", "memory", "pids", "disk", "bandwidth") if getattr(options, name)}
    asked |= {"io"} if options.io != Rates() else set()
    ignored = sorted(asked.intersection(not_enforced))
    if ignored:
        log.warn("{name}: the process engine does not enforce {options}", name=spec.name, options=", ".join(ignored))
