"""From CC to an environment that is ready, beside a bare container of the same image that imports rclpy.

Ready is what the acknowledgement of CC says: the environment's endpoint is up in ROS 2 and has joined the Master.
"""

from __future__ import annotations

import asyncio
import secrets
import shutil
import statistics
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rce.bench.report import aligned, machine
from rce.client import Robot
from rce.errors import StartFailed

BARE = "docker run"
COMMAND = ("python3", "-c", "import rclpy")
Samples = dict[str, list[float]]  # seconds, by engine or BARE


async def measure(robots: Mapping[str, Robot], image: str, samples: int) -> Samples:
    """One start of each engine in turn, so that what else the machine does hits all alike; the first does not count.

    `robots` are at platforms, by the names of their engines. The bare container is left out where there is no program
    `docker`. StartFailed if it fails.
    """
    taken: Samples = {name: [] for name in robots}
    if "docker" in robots and shutil.which("docker"):
        taken[BARE] = []
    for number in range(samples + 1):
        for name, into in taken.items():
            seconds = await _bare(image) if name == BARE else await _start(robots[name])
            if number:
                into.append(seconds)
    return taken


async def _start(robot: Robot) -> float:
    tag = f"start_{secrets.token_hex(4)}"
    began = time.monotonic()
    await robot.create_environment(tag, restart="no")
    seconds = time.monotonic() - began
    await robot.destroy_environment(tag)
    return seconds


async def _bare(image: str) -> float:
    name = f"rce-bench-{secrets.token_hex(4)}"
    began = time.monotonic()
    await _docker("run", "--name", name, "--network", "none", image, *COMMAND)
    seconds = time.monotonic() - began
    await _docker("rm", name)
    return seconds


async def _docker(*words: str) -> None:
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec("docker", *words, stdout=pipe, stderr=pipe)
    _, errors = await process.communicate()
    if process.returncode:
        raise StartFailed(f"docker {words[0]}: {errors.decode(errors='replace').strip()}")


def as_text(taken: Samples) -> str:
    """Medians and extremes in seconds, with their ratios to the bare container."""
    host = machine()
    title = f"CC to ready; {host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
    bare = statistics.median(taken[BARE]) if taken.get(BARE) else 0.0
    rows = [["", "median", "least", "most", "ratio"]]
    rows += [_row(name, seconds, bare) for name, seconds in taken.items()]
    return "\n".join([title, "", *aligned(rows)])


def _row(name: str, seconds: Sequence[float], bare: float) -> list[str]:
    median = statistics.median(seconds)
    return [
        name,
        *(f"{each:.3f} s" for each in (median, min(seconds), max(seconds))),
        f"{median / bare:.2f}" if bare else "",
    ]


def as_data(taken: Samples) -> dict[str, Any]:
    """Every sample, in seconds."""
    return {"machine": machine(), "seconds": taken}
