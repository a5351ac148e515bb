"""Calls to the agents of a group's members."""

from __future__ import annotations

import asyncio

import msgspec

from containers.kubernetes.groups import Groups, connections
from containers.kubernetes.objects import Pod
from rce.control.calls.agents import ConnectGroup
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.errors import Lost
from rce.protocol.messages import ContainerData


def member(tag: str, address: str, pod_address: str, node: str = "n1") -> Pod:
    group = Group("ann/pair", "10.128.0.0/24", address, {tag: address})
    spec = EnvironmentSpec(f"ann/{tag}", tag[0] * 32, "", ContainerData(), group)
    return Pod(f"rce-{tag}", "rce", tag, spec.run, node, pod_address, "c", True, False, None, "", "", 0, spec)


LEFT, RIGHT = member("left", "10.128.0.2", "10.1.0.5"), member("right", "10.128.0.3", "10.1.1.6", "n2")
NAMED = {"left": "10.128.0.2", "right": "10.128.0.3"}


def test_each_member_is_told_all_names_and_the_pods_of_the_others() -> None:
    assert connections([LEFT, RIGHT]) == [
        (LEFT, ConnectGroup("l" * 32, NAMED, ["10.1.1.6"])),
        (RIGHT, ConnectGroup("r" * 32, NAMED, ["10.1.0.5"])),
    ]


def test_pod_without_an_address_is_nobodys_peer() -> None:
    early = msgspec.structs.replace(RIGHT, address="")
    assert connections([LEFT, early])[0][1].peers == []


async def test_agent_that_is_away_does_not_keep_the_others_from_being_told() -> None:
    told: list[str] = []

    async def call(node: str, call: ConnectGroup) -> None:
        if node == "n1":
            raise Lost("node n1 has no agent")
        told.append(call.run)

    await Groups(lambda group: [LEFT, RIGHT], call).update("ann/pair")
    assert told == ["r" * 32]


async def test_agent_is_not_told_of_an_earlier_state_after_a_later_one() -> None:
    members = [LEFT]
    told: list[ConnectGroup] = []
    answered = asyncio.Event()

    async def call(node: str, call: ConnectGroup) -> None:
        if not told:
            told.append(call)
            await answered.wait()
        else:
            told.append(call)

    groups = Groups(lambda group: list(members), call)
    first = asyncio.create_task(groups.update("ann/pair"))
    await asyncio.sleep(0)
    second = asyncio.create_task(groups.update("ann/pair"))
    await asyncio.sleep(0)
    members.append(RIGHT)
    third = asyncio.create_task(groups.update("ann/pair"))
    answered.set()
    await asyncio.gather(first, second, third)
    assert [each.peers for each in told if each.run == LEFT.spec.run] == [[], ["10.1.1.6"]], (
        "one update stands for all that wait for their turn"
    )
