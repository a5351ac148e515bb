"""Comparison of what a platform acknowledged with what is there: REST, processes, directories, uploads."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from msgspec import Struct

from rce.api.client import ApiClient
from rce.api.views.machines import MachineView
from rce.api.views.resources import (
    ConnectionView,
    EnvironmentView,
    InterfaceView,
    NodeView,
    ParameterView,
    RobotView,
)
from rce.bench.chaos import processes
from rce.bench.chaos.model import Fact, connection
from rce.bench.chaos.platform import ADMINISTRATOR, TASK_SET, USER, Platform
from rce.bench.chaos.violations import Violation
from rce.errors import RceError

SETTLE_TIMEOUT = 180.0  # seconds within which a platform without faults must agree with the model
POLL_INTERVAL = 0.2  # seconds


class Found(Struct):
    """State of the platform as it was found.

    Attributes:
        facts: Facts that REST and the map service show.
        unsettled: What is neither there nor gone, as an environment that starts.
        endpoints: Processes of Environment endpoints by environment.
        nodes: Processes of nodes by environment and node.
        directories: Directories of lives by environment.
        trash: Directories that wait for their removal.
    """

    facts: set[Fact]
    unsettled: list[str]
    endpoints: Counter[str]
    nodes: Counter[tuple[str, str]]
    directories: Counter[str]
    trash: int


def differences(expected: set[Fact], found: Found) -> list[str]:
    """Return what does not agree, as sentences without an end."""
    environments = Counter(each[1] for each in expected if each[0] == "environment")
    nodes = Counter((each[1], each[2]) for each in expected if each[0] == "node")
    return [
        *found.unsettled,
        *(f"missing: {' '.join(each)}" for each in sorted(expected - found.facts)),
        *(f"not asked for: {' '.join(each)}" for each in sorted(found.facts - expected)),
        *_counts("processes of environment", environments, found.endpoints),
        *_counts("processes of node", _joined(nodes), _joined(found.nodes)),
        *_counts("directories of environment", environments, found.directories),
        *([f"{found.trash} directories in the trash"] if found.trash else []),
    ]


def _joined(nodes: Counter[tuple[str, str]]) -> Counter[str]:
    return Counter({"/".join(key): count for key, count in nodes.items()})


def _counts(what: str, expected: Counter[str], found: Counter[str]) -> Iterator[str]:
    for name in sorted({*expected, *found}):
        if expected[name] != found[name]:
            yield f"{found[name]} {what} {name} instead of {expected[name]}"


async def settle(expected: set[Fact], look: Callable[[], Found]) -> float:
    """Wait until a platform agrees with the model; return the seconds that this took.

    `look` returns what is there.

    Raises:
        Violation: It does not within SETTLE_TIMEOUT; the message has the differences.
    """
    began = time.monotonic()
    while True:
        try:
            found = differences(expected, await asyncio.to_thread(look))
        except RceError as error:
            found = [f"REST: {error}"]
        if not found:
            return time.monotonic() - began
        if time.monotonic() > began + SETTLE_TIMEOUT:
            raise Violation(f"after {SETTLE_TIMEOUT:g} s without faults:\n" + "\n".join(found))
        await asyncio.sleep(POLL_INTERVAL)


def look(platform: Platform) -> Found:
    """Return what is there.

    Raises:
        RceError: REST or the map service does not answer.
    """
    found = look_without_maps(platform.api(), platform.api(ADMINISTRATOR), [platform.directory / TASK_SET])
    for upload in platform.maps().uploads():
        found.facts.add(("upload", upload.name))
        if upload.offset != upload.length:
            found.unsettled.append(f"upload {upload.name} has {upload.offset} of {upload.length} bytes")
    return found


def look_without_maps(api: ApiClient, administrator: ApiClient, directories: Sequence[Path]) -> Found:
    """Return what is there, as the user and an administrator see it, and in the directories of task sets.

    Raises:
        RceError: REST does not answer.
    """
    facts, unsettled = _graph(api)
    unsettled += [
        f"{each.role} {each.name} is {each.state}"
        for each in administrator.items(MachineView, "machines")
        if each.state != "joined"
    ]
    running = [each for directory in directories for each in processes.of_environments(directory, USER)]
    lives = [path for directory in directories for path in (directory / "environments" / USER).glob("*/*")]
    return Found(
        facts,
        unsettled,
        Counter(each.environment for each in running if not each.node),
        Counter((each.environment, each.node) for each in running if each.node),
        Counter(path.parent.name for path in lives),
        sum(_entries(directory / "trash") for directory in directories),
    )


def _entries(directory: Path) -> int:
    return sum(1 for _ in directory.iterdir()) if directory.exists() else 0


def _graph(api: ApiClient) -> tuple[set[Fact], list[str]]:
    """Return the facts that REST shows, and what is in another state than its last one."""
    facts: set[Fact] = set()
    unsettled: list[str] = []

    def add(fact: Fact, state: str, settled: str) -> None:
        facts.add(fact)
        if state != settled:
            unsettled.append(f"{' '.join(fact)} is {state}")

    for robot in api.items(RobotView, "robots"):
        add(("robot", robot.robotID), robot.state, "connected")
    for environment in api.items(EnvironmentView, "environments"):
        tag = environment.containerTag
        add(("environment", tag), environment.state, "ready")
        for node in api.items(NodeView, "environments", tag, "nodes"):
            add(("node", tag, node.nodeTag), node.state, "running")
        for each in api.items(ParameterView, "environments", tag, "parameters"):
            facts.add(("parameter", tag, each.name, str(each.value)))
    for interface in api.items(InterfaceView, "interfaces"):
        add(("interface", interface.endpointTag, interface.interfaceTag), interface.state, "ready")
    for link in api.items(ConnectionView, "connections"):
        add(connection(link.tagA, link.tagB), link.state, "up")
    return facts, unsettled
