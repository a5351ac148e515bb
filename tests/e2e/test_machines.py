"""Several machines: robots and environments on both, data between them, one cut off or killed under traffic.

As root the machines are network namespaces, otherwise this one under two names.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from certified import certify
from machines import Host, Machines
from namespaces import Network, network
from real_platform import USER, until
from test_kills import Traffic, next_event

from rce.certificates import Authority
from rce.client import Environment, Publisher, Reconnected, Robot, Subscriber
from rce.errors import TimedOut
from rce.messages import EnvironmentEvent, Qos

STRING = "std_msgs/String"
RELIABLE = Qos(reliability="reliable", depth=1000)
SLOTS = 4
LARGE = 3  # slots: two such environments are on two machines
NOTICED = 60.0  # seconds in which a machine that is cut off is noticed and its environments run elsewhere


@pytest.fixture(scope="module")
def wires() -> Iterator[Network | None]:
    """Between the machines; None where they are one."""
    with ExitStack() as stack:
        yield stack.enter_context(network("a", "b")) if os.geteuid() == 0 else None


def made(
    wires: Network | None,
    directory: Path,
    arguments: Sequence[str],
    ws_port: int = 9010,
    dockers: Mapping[str, str] | None = None,
) -> Machines:
    """`dockers` are the addresses of the machines' Docker daemons, for the engine `docker`."""
    authority = Authority.make("test")

    def host(name: str) -> Host:
        at = "127.0.0.1"
        if wires is not None:
            at = wires.addresses.get(name, wires.host)
        entered_by = wires.entered_by(name) if wires is not None and name in wires.addresses else ()
        return Host(
            name, at, entered_by, certify(directory / "tls" / name, authority, [at]), (dockers or {}).get(name, "")
        )

    return Machines(directory, host("master"), [host("a"), host("b")], arguments, SLOTS, ws_port=ws_port)


@pytest.fixture(scope="module")
async def machines(
    wires: Network | None, arguments: list[str], tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Machines]:
    words = [f"{option}={value}" for option, value in zip(arguments[::2], arguments[1::2], strict=True)]
    async with made(wires, tmp_path_factory.mktemp("machines"), ["--allow-unisolated", *words]) as machines:
        yield machines


def machine_of(machines: Machines, robot: Robot) -> str:
    """The one whose Robot endpoint serves this robot."""
    assert robot.connection is not None
    endpoint = robot.connection.endpoint
    (name,) = [name for name in machines.hosts if machines.url(name) == endpoint]
    return name


async def test_use_case_1_robots_and_environments_on_two_machines(machines: Machines) -> None:
    await use_case_1(machines)


async def use_case_1(machines: Machines) -> None:
    """Figure 7 of the Rapyuta paper. Numbers go from a robot into one environment, from there into the other machine's
    (C2C-2), and from there to the robots of both machines."""
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
        heard = [
            await robot.environment("second").subscriber("/heard", STRING, depth=1000, qos=RELIABLE)
            for robot in (one, two)
        ]
        said = await first.publisher("/say", STRING, qos=RELIABLE)
        await through_all(said, heard)
        for number in range(50):  # one by one: a node may drop what comes faster than it takes it
            said.offer({"data": str(number)})
            assert [await next_number(stream) for stream in heard] == [number] * 2


async def through_all(said: Publisher, heard: Sequence[Subscriber]) -> None:
    """Empty messages, until one has come through: nodes hear nothing before they and the endpoint know each other."""
    async with asyncio.timeout(60):
        while True:
            said.offer({"data": ""})
            with suppress(TimedOut):
                for stream in heard:
                    await stream.get(1)
                return


async def next_number(stream: Subscriber) -> int:
    while not (text := (await stream.get(30))["data"]):
        pass
    return int(text)


async def test_use_case_3_robots_of_two_machines(machines: Machines) -> None:
    """A network of robots, without environments: messages and calls between robots at two Robot endpoints."""
    async with machines.robot("one") as one, machines.robot("two") as two:
        assert machine_of(machines, one) != machine_of(machines, two)
        for sender, receiver in ((one, two), (two, one)):
            said = await sender.publisher("say", STRING, qos=RELIABLE)
            heard = await receiver.subscriber("hear", STRING, to=f"{sender.name}/say", depth=1000, qos=RELIABLE)
            await said.wait_connected()
            for number in range(200):
                said.offer({"data": f"{number} from {sender.name}"}, keep=1000)
            async with asyncio.timeout(30):
                got = [(await heard.get())["data"] for _ in range(200)]
            assert got == [f"{number} from {sender.name}" for number in range(200)]


@pytest.mark.parametrize("how", ["cut", "killed"])
async def test_a_machine_that_is_gone_under_traffic(machines: Machines, wires: Network | None, how: str) -> None:
    if wires is None:
        pytest.skip("the machines are one here: run the tests as root to have networks that can be cut")
    await gone_under_traffic(machines, wires, how)


async def gone_under_traffic(machines: Machines, wires: Network, how: str, own_types: bool = True) -> None:
    """Its environment comes up on the other with nodes, parameters, interfaces, and its connection to an environment
    there. When it comes back, it is cleaned and takes environments again."""
    async with (
        machines.robot(f"one_{how}") as one,
        machines.robot(f"two_{how}") as two,
        one.environment("moving", size=2) as moving,
    ):
        gone = machines.machine_of("moving")
        robot = one if machine_of(machines, one) != gone else two
        (left,) = set(machines.hosts) - {gone}
        assert machine_of(machines, robot) == left
        async with robot.environment("staying", specialFeatures=[left]) as staying:
            traffic = Traffic(robot, robot.environment(moving.tag), own_types)
            await traffic.start()
            through = await onward(robot, moving.tag, staying)
            events = robot.events()
            wires.cut(gone) if how == "cut" else await kill(machines, wires, gone)
            lost = await next_event(events, EnvironmentEvent, "lost")
            assert (lost.containerTag, lost.state) == ("moving", "lost")
            assert f"container-{gone} has been away" in lost.reason
            ready = await next_event(events, EnvironmentEvent, "ready")
            assert ready.containerTag == "moving"
            assert machines.machine_of("moving") == left
            await traffic.flows(NOTICED)
            if own_types:
                assert await traffic.parameter() == "moving"
            before = len(through)
            await until(lambda: len(through) > before, what="messages through the environment that stayed")
            joined = machines.log("master").count(f"container-{gone} joined")
            wires.mend(gone) if how == "cut" else await machines.revive(gone)
            await until(lambda: machines.log("master").count(f"container-{gone} joined") > joined)
            async with robot.environment("again", specialFeatures=[gone]):
                assert machines.machine_of("again") == gone
                running = machines.directory / f"container-{gone}" / "environments" / USER
                await until(lambda: os.listdir(running) == ["again"], what="the old life is removed")
                await traffic.flows()
            await traffic.stop()


async def onward(robot: Robot, first: str, second: Environment) -> list[str]:
    """What comes out of the first environment goes through the second to the robot; the list that it comes to."""
    got: list[str] = []
    await second.add_node("relay", "Relay", "relay.py", args=STRING)
    await robot.add_interface(first, "onward", "SubscriberInterface", STRING, addr="/out_String", qos=RELIABLE)
    await robot.add_interface(second.tag, "in", "PublisherInterface", STRING, addr="/in_String", qos=RELIABLE)
    await robot.connect(f"{first}/onward", f"{second.tag}/in")
    await second.subscriber("/out_String", STRING, callback=lambda message: got.append(message["data"]), depth=1000)
    await until(lambda: got, what="messages through both environments")
    return got


async def kill(machines: Machines, wires: Network, host: str) -> None:
    """SIGKILL all that runs there."""
    wires.kill(host)
    await asyncio.gather(*(program.process.wait() for program in machines.on(host)))


async def test_the_robots_of_a_dead_endpoint_go_on_at_the_other(machines: Machines) -> None:
    async with machines.robot("one") as one, machines.robot("two") as two, one.environment("brain") as brain:
        traffic = Traffic(one, brain)
        await traffic.start()
        before = machine_of(machines, one)
        assert machine_of(machines, two) != before
        events = one.events()
        await machines.programs[f"robot-{before}"].kill()
        assert await next_event(events, Reconnected) == Reconnected(resumed=True)
        assert machine_of(machines, one) == machine_of(machines, two)
        await traffic.flows()
        assert await traffic.parameter() == "brain"
        await traffic.stop()
        await machines.start_program(f"robot-{before}")
