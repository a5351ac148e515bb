"""Platform on two machines: data between them, and the loss of one under traffic.

As root the machines are network namespaces, otherwise this machine under two names.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack

import pytest

from rce.bench.network.bridge import Network
from rce.client import Reconnected
from tests.support.e2e.machines import Machines
from tests.support.e2e.namespaces import network
from tests.support.e2e.traffic import Traffic, next_event
from tests.support.e2e.use_cases import (
    RELIABLE,
    STRING,
    check_failover_under_traffic,
    machine_of,
    platform_on,
    use_case_1,
)


@pytest.fixture(scope="module")
def wires() -> Iterator[Network | None]:
    """Network of the machines, or None without root."""
    with ExitStack() as stack:
        yield stack.enter_context(network("a", "b")) if os.geteuid() == 0 else None


@pytest.fixture(scope="module")
async def machines(
    wires: Network | None, arguments: list[str], tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Machines]:
    words = [f"{option}={value}" for option, value in zip(arguments[::2], arguments[1::2], strict=True)]
    async with platform_on(wires, tmp_path_factory.mktemp("machines"), ["--allow-unisolated", *words]) as machines:
        yield machines


async def test_use_case_1_robots_and_environments_on_two_machines(machines: Machines) -> None:
    await use_case_1(machines)


async def test_use_case_3_robots_of_two_machines(machines: Machines) -> None:
    """Messages between robots at two Robot endpoints, without environments."""
    await machines.wait_for_no_robots()
    async with machines.robot("one") as one, machines.robot("two") as two:
        assert machine_of(machines, one) != machine_of(machines, two)
        for sender, receiver in ((one, two), (two, one)):
            publisher = await sender.publisher("say", STRING, qos=RELIABLE)
            subscriber = await receiver.subscriber("hear", STRING, to=f"{sender.name}/say", depth=1000, qos=RELIABLE)
            await publisher.wait_connected()
            for number in range(200):
                publisher.offer({"data": f"{number} from {sender.name}"}, keep=1000)
            async with asyncio.timeout(60):
                received = [(await subscriber.get())["data"] for _ in range(200)]
            assert received == [f"{number} from {sender.name}" for number in range(200)]


@pytest.mark.parametrize("how", ["cut", "killed"])
async def test_environments_of_a_lost_machine_move(machines: Machines, wires: Network | None, how: str) -> None:
    if wires is None:
        pytest.skip("networks that can be cut need root: run the tests as root")
    await check_failover_under_traffic(machines, wires, how)


async def test_robots_of_a_killed_endpoint_resume_at_the_other(machines: Machines) -> None:
    await machines.wait_for_no_robots()
    async with machines.robot("one") as one, machines.robot("two") as two, one.environment("brain") as brain:
        traffic = Traffic(one, brain)
        await traffic.start()
        before = machine_of(machines, one)
        assert machine_of(machines, two) != before
        events = one.events()
        await machines.programs[f"robot-{before}"].kill()
        assert await next_event(events, Reconnected) == Reconnected(resumed=True)
        assert machine_of(machines, one) == machine_of(machines, two)
        await traffic.wait_for_round_trip()
        assert await traffic.parameter() == "brain"
        await traffic.stop()
        await machines.start_program(f"robot-{before}")
