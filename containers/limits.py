"""Size of a machine, and resource limits of one environment on it."""

from __future__ import annotations

import os

from msgspec import Struct

from rce.control.calls.environments import EnvironmentSpec
from rce.errors import LimitExceeded
from rce.protocol import slots
from rce.protocol.messages import Rates


class Size(Struct, frozen=True):
    """Size of a machine: number of cores, and memory in bytes."""

    cores: float
    memory: int

    @staticmethod
    def here() -> Size:
        """Return the size of this machine."""
        return Size(float(os.cpu_count() or 1), os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


class Limits(Struct, frozen=True):
    """Limits of one environment: memory in bytes, cores, processes and threads, bytes per second, GPUs."""

    memory: int
    cpu: float
    pids: int
    io: Rates = Rates()
    gpus: list[str] = []  # numbers of the GPUs


def check(spec: EnvironmentSpec, most: Size) -> None:
    """Check that an environment asks for no more than a machine has.

    Raises:
        LimitExceeded: It asks for more.
    """
    options = spec.options
    for field, asked, limit in (("cpu", options.cpu, most.cores), ("memory", options.memory, most.memory)):
        if asked > limit:
            raise LimitExceeded(
                f"environment {spec.name} asks for {field} {asked:g}, this machine has {limit:g}",
                field=f"containerData.{field}",
                asked=asked,
                limit=limit,
            )


def limits(spec: EnvironmentSpec, gpus: list[str], most: Size) -> Limits:
    """Return the limits that an environment asks for; where it names none, those of its slots.

    Raises:
        LimitExceeded: It asks for more than the machine has.
    """
    check(spec, most)
    options = spec.options
    return Limits(
        int(options.memory) or min(slots.MEMORY * options.size, most.memory),
        options.cpu or min(slots.CORES * options.size, most.cores),
        options.pids or slots.PIDS * options.size,
        options.io,
        gpus,
    )
