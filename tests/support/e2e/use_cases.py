"""Use cases on several machines, which tests of different engines share."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from rce.bench.network.bridge import Network
from rce.client import Environment, Publisher, Robot, Subscriber
from rce.errors import TimedOut
from rce.net.certificates import Authority
from rce.protocol.messages import EnvironmentEvent, Qos
from tests.support.certificates import certify
from tests.support.e2e.machines import Host, Machines
from tests.support.e2e.real_platform import USER, until
from tests.support.e2e.traffic import Traffic, next_event

STRING = "std_msgs/String"


RELIABLE = Qos(reliability="reliable", depth=1000)


SLOTS = 4


LARGE = 3  # slots: two such environments do not fit on one machine


FAILOVER_TIMEOUT = 60.0  # seconds until the environments of a lost machine run elsewhere


def platform_on(
    wires: Network | None,
    directory: Path,
    arguments: Sequence[str],
    ws_port: int = 9010,
    dockers: Mapping[str, str] | None = None,
) -> Machines:
    """Return a platform on two machines. `dockers` are the addresses of their Docker daemons, if they have any."""
    authority = Authority.make("test")

    def host(name: str) -> Host:
        at = "127.0.0.1"
        if wires is not None:
            at = wires.addresses.get(name, wires.host)
        command_prefix = wires.command_prefix(name) if wires is not None and name in wires.addresses else ()
        return Host(
            name, at, command_prefix, certify(directory / "tls" / name, authority, [at]), (dockers or {}).get(name, "")
        )

    return Machines(directory, host("master"), [host("a"), host("b")], arguments, SLOTS, ws_port=ws_port)


def machine_of(machines: Machines, robot: Robot) -> str:
    """Return the machine whose Robot endpoint serves a robot."""
    assert robot.connection is not None
    endpoint = robot.connection.endpoint
    (name,) = [name for name in machines.hosts if machines.url(name) == endpoint]
    return name


async def use_case_1(machines: Machines) -> None:
    """Figure 7 of the Rapyuta paper.

    Numbers go from a robot into one environment, from there to an environment on the other machine (C2C-2), and from
    there to robots on both machines.
    """
    await machines.wait_for_no_robots()
    async with (
        machines.robot("one") as one,
        machines.robot("two") as two,
        one.environment("first", size=LARGE) as first,
        two.environment("second", size=LARGE) as second,
    ):
        assert machines.machine_of("first") != machines.machine_of("second")
        assert machine_of(machines, one) != machine_of(machines, two)
        await asyncio.gather(*(each.add_node("echo", "rce_demo", "echo.py") for each in (first, second)))
        await one.add_interface("first", "out", "SubscriberInterface", STRING, addr="/heard", qos=RELIABLE)
        await one.add_interface("second", "in", "PublisherInterface", STRING, addr="/say", qos=RELIABLE)
        await one.connect("first/out", "second/in")
        subscribers = [
            await robot.environment("second").subscriber("/heard", STRING, depth=1000, qos=RELIABLE)
            for robot in (one, two)
        ]
        publisher = await first.publisher("/say", STRING, qos=RELIABLE)
        await wait_until_connected(publisher, subscribers)
        for number in range(50):  # one by one, because a node may drop messages that come too fast
            publisher.offer({"data": str(number)})
            assert [await next_number(stream) for stream in subscribers] == [number] * 2


async def wait_until_connected(publisher: Publisher, subscribers: Sequence[Subscriber]) -> None:
    """Send empty messages until one arrives: nodes receive nothing before DDS discovery has finished."""
    async with asyncio.timeout(60):
        while True:
            publisher.offer({"data": ""})
            with suppress(TimedOut):
                for stream in subscribers:
                    await stream.get(1)
                return


async def next_number(stream: Subscriber) -> int:
    while not (text := (await stream.get(60))["data"]):
        pass
    return int(text)


async def check_failover_under_traffic(machines: Machines, wires: Network, how: str, own_types: bool = True) -> None:
    """A machine is cut off or killed. Its environment starts on the other one, complete and connected.

    When the machine is back, its old environments are removed, and it accepts new ones.
    """
    await machines.wait_for_no_robots()
    async with (
        machines.robot(f"one_{how}") as one,
        machines.robot(f"two_{how}") as two,
        one.environment("moving", size=2) as moving,
    ):
        gone = machines.machine_of("moving")
        robot = one if machine_of(machines, one) != gone else two
        (left,) = set(machines.hosts) - {gone}
        assert machine_of(machines, robot) == left
        async with robot.environment("staying", special_features=[left]) as staying:
            traffic = Traffic(robot, robot.environment(moving.tag), own_types)
            await traffic.start()
            received = await chain_environments(robot, moving.tag, staying)
            events = robot.events()
            wires.cut(gone) if how == "cut" else await kill(machines, wires, gone)
            lost = await next_event(events, EnvironmentEvent, "lost")
            assert (lost.containerTag, lost.state) == ("moving", "lost")
            assert f"container-{gone} has been away" in lost.reason
            ready = await next_event(events, EnvironmentEvent, "ready")
            assert ready.containerTag == "moving"
            assert machines.machine_of("moving") == left
            await traffic.wait_for_round_trip(FAILOVER_TIMEOUT)
            if own_types:
                assert await traffic.parameter() == "moving"
            before = len(received)
            await until(lambda: len(received) > before, what="messages through the remaining environment")
            joined = machines.log("master").count(f"container-{gone} joined")
            wires.reconnect(gone) if how == "cut" else await machines.revive(gone)
            await until(lambda: machines.log("master").count(f"container-{gone} joined") > joined)
            async with robot.environment("again", special_features=[gone]):
                assert machines.machine_of("again") == gone
                running = machines.directory / f"container-{gone}" / "environments" / USER
                await until(lambda: os.listdir(running) == ["again"], what="the old environment is removed")
                await traffic.wait_for_round_trip()
            await traffic.stop()


async def chain_environments(robot: Robot, first: str, second: Environment) -> list[str]:
    """Connect the first environment through the second to the robot; return the list of what the robot receives."""
    got: list[str] = []
    await second.add_node("relay", "Relay", "relay.py", args=STRING)
    await robot.add_interface(first, "onward", "SubscriberInterface", STRING, addr="/out_String", qos=RELIABLE)
    await robot.add_interface(second.tag, "in", "PublisherInterface", STRING, addr="/in_String", qos=RELIABLE)
    await robot.connect(f"{first}/onward", f"{second.tag}/in")
    await second.subscriber("/out_String", STRING, callback=lambda message: got.append(message["data"]), depth=1000)
    await until(lambda: got, what="messages through both environments")
    return got


async def kill(machines: Machines, wires: Network, host: str) -> None:
    """Kill everything on a machine."""
    wires.kill(host)
    await asyncio.gather(*(program.process.wait() for program in machines.on(host)))
