"""How large a machine is, and what one environment of it may use."""

from __future__ import annotations

import os

from msgspec import Struct

from rce import slots
from rce.calls.environments import EnvironmentSpec
from rce.errors import LimitExceeded
from rce.messages import Rates


class Size(Struct, frozen=True):
    """How large a machine is."""

    cores: float
    memory: int

    @staticmethod
    def here() -> Size:
        return Size(float(os.cpu_count() or 1), os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


class Limits(Struct, frozen=True):
    """What one environment may use: memory in bytes, cores, processes and threads, bytes a second, GPUs."""

    memory: int
    cpu: float
    pids: int
    io: Rates = Rates()
    gpus: list[str] = []  # their numbers


def check(spec: EnvironmentSpec, most: Size) -> None:
    """LimitExceeded if an environment asks for more than that."""
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
    """The limits that an environment asks for, or those of its slots. LimitExceeded."""
    check(spec, most)
    options = spec.options
    return Limits(
        int(options.memory) or min(slots.MEMORY * options.size, most.memory),
        options.cpu or min(slots.CORES * options.size, most.cores),
        options.pids or slots.PIDS * options.size,
        options.io,
        gpus,
    )
