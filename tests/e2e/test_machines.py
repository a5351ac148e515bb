"""Several machines: robots and environments on both, data between them, one cut off or killed under traffic."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from certified import certify
from machines import Host, Machines

from rce.certificates import Authority
from rce.messages import Qos

STRING = "std_msgs/String"
RELIABLE = Qos(reliability="reliable", depth=1000)
SLOTS = 4
LARGE = 3  # slots: two such environments are on two machines


@pytest.fixture(scope="module")
async def machines(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Machines]:
    words = [f"{option}={value}" for option, value in zip(arguments[::2], arguments[1::2], strict=True)]
    directory, authority = tmp_path_factory.mktemp("machines"), Authority.make("test")
    names = ("master", "a", "b")
    master, a, b = (Host(name, tls=certify(directory / "tls" / name, authority, ["127.0.0.1"])) for name in names)
    made = Machines(directory, master, [a, b], words, SLOTS)
    await made.start()
    yield made
    await made.stop()


async def test_use_case_1_robots_and_environments_on_two_machines(machines: Machines) -> None:
    """Figure 7 of the Rapyuta paper. Numbers go from a robot into one environment, from there into the other machine's
    (C2C-2), and from there to the robots of both machines."""
    async with (
        machines.robot("one") as one,
        machines.robot("two") as two,
        one.environment("first", size=LARGE) as first,
        two.environment("second", size=LARGE) as second,
    ):
        assert machines.machine_of("first") != machines.machine_of("second")
        await asyncio.gather(
            first.add_node("relay", "Relay", "relay.py", args=STRING),
            second.add_node("relay", "Relay", "relay.py", args=STRING),
        )
        await one.add_interface("first", "out", "SubscriberInterface", STRING, addr="/out_String", qos=RELIABLE)
        await one.add_interface("second", "in", "PublisherInterface", STRING, addr="/in_String", qos=RELIABLE)
        await one.connect("first/out", "second/in")
        heard = [
            await robot.environment("second").subscriber("/out_String", STRING, depth=1000, qos=RELIABLE)
            for robot in (one, two)
        ]
        said = await first.publisher("/in_String", STRING, qos=RELIABLE)
        for number in range(200):
            said.offer({"data": str(number)}, keep=1000)
        async with asyncio.timeout(30):
            for stream in heard:
                assert [(await stream.get())["data"] for _ in range(200)] == [str(number) for number in range(200)]
