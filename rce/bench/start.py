"""Benchmark of the start of environments, compared with a bare container of the same image that imports rclpy.

The time is from the message CC to its acknowledgement: the endpoint of the environment is up in ROS 2 and has joined
the Master. The time of a service is from the robot's request to the answer to its first message; nothing of the service
runs before. Both are measured with and without prepared environments.
"""

from __future__ import annotations

import asyncio
import secrets
import shutil
import statistics
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rce.api.client import ApiClient
from rce.api.views import NewOffer, OfferedNode, OfferView
from rce.bench.report import aligned, machine
from rce.client import Robot
from rce.errors import StartFailed

BARE, WARM = "docker run", "process, prepared"
SERVICE = NewOffer(
    "bench_echo",
    takes={"say": "std_msgs/String"},
    gives={"heard": "std_msgs/String"},
    nodes=[OfferedNode("echo", "rce_demo", "echo")],
)
PAUSE = 2.0  # seconds between samples, in which the next environment is prepared
COMMAND = ("python3", "-c", "import rclpy")
Samples = dict[str, list[float]]  # seconds, by engine or BARE


async def measure(
    robots: Mapping[str, Robot], image: str, samples: int, services: bool = True, pause: float = PAUSE
) -> Samples:
    """Measure one start of each engine in turn, so that other load affects all alike; the first start is discarded.

    Args:
        robots: Robots connected to platforms, by the names of the engines.
        image: Image of the bare container, which is measured only if `docker` is installed.
        samples: Number of samples.
        services: Measure services too, of platforms with `SERVICE`.
        pause: Seconds between samples.

    Raises:
        StartFailed: The bare container failed.
    """
    taken: Samples = {name: [] for name in robots}
    if services:
        taken |= {f"service, {name}": [] for name in robots}
    if "docker" in robots and shutil.which("docker"):
        taken[BARE] = []
    for number in range(samples + 1):
        for name, into in taken.items():
            await asyncio.sleep(pause)
            if name == BARE:
                seconds = await _bare(image)
            elif name in robots:
                seconds = await _start(robots[name])
            else:
                seconds = await _serve(robots[name.removeprefix("service, ")])
            if number:
                into.append(seconds)
    return taken


async def _start(robot: Robot) -> float:
    """Return the seconds that the start of an environment takes."""
    tag = f"start_{secrets.token_hex(4)}"
    started = time.monotonic()
    await robot.create_environment(tag, restart="no")
    seconds = time.monotonic() - started
    await robot.destroy_environment(tag)
    return seconds


def publish(api: ApiClient) -> None:
    """Publish the service that is measured."""
    api.post(OfferView, "catalogue", body=SERVICE)


async def _serve(robot: Robot) -> float:
    """Return the seconds until a service that did not run has answered."""
    started = time.monotonic()
    service = await robot.service(SERVICE.name)
    await service.publisher("say").publish({"data": "first"})
    await service.subscriber("heard").get()
    seconds = time.monotonic() - started
    await service.leave()
    await robot.destroy_environment(service.tag)
    return seconds


async def _bare(image: str) -> float:
    """Return the seconds that a bare container takes."""
    name = f"rce-bench-{secrets.token_hex(4)}"
    started = time.monotonic()
    await _docker("run", "--name", name, "--network", "none", image, *COMMAND)
    seconds = time.monotonic() - started
    await _docker("rm", name)
    return seconds


async def _docker(*words: str) -> None:
    """Run a command of Docker.

    Raises:
        StartFailed: It failed.
    """
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec("docker", *words, stdout=pipe, stderr=pipe)
    _, errors = await process.communicate()
    if process.returncode:
        raise StartFailed(f"docker {words[0]}: {errors.decode(errors='replace').strip()}")


def as_text(taken: Samples) -> str:
    """Return a table of medians and extremes in seconds, with the ratio to the bare container."""
    host = machine()
    measured = "CC to ready, and use of a service to its first answer"
    title = f"{measured}; {host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
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
    """Return all samples in seconds, for JSON."""
    return {"machine": machine(), "seconds": taken}
