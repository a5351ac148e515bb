"""Network groups: each member's agent is told the pods of the other members."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from weakref import WeakValueDictionary

from twisted.logger import Logger

from containers.kubernetes.objects import Pod
from rce.control.calls.agents import ConnectGroup
from rce.errors import RceError

log = Logger()


class _Turns:
    """Updates of one group, which are made one after the other: an agent is not told of an earlier state after a later.

    Attributes:
        asked: Number of updates that were asked for.
        told: Number of the last of them whose state, or a later one, the agents were told of.
    """

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        self.asked = self.told = 0


class Groups:
    """Tells agents of the members of groups.

    Args:
        members: Returns the running members of a group.
        call: Makes a call to the agent of a node.
    """

    def __init__(
        self, members: Callable[[str], Sequence[Pod]], call: Callable[[str, ConnectGroup], Awaitable[None]]
    ) -> None:
        self._members = members
        self._call = call
        self._turns: WeakValueDictionary[str, _Turns] = WeakValueDictionary()  # by group

    async def update(self, group: str) -> None:
        """Connect all members of a group with each other, as they are when this is called or later."""
        turns = self._turns.setdefault(group, _Turns())
        turns.asked += 1
        number = turns.asked
        async with turns.lock:
            if turns.told >= number:
                return
            asked = turns.asked
            for pod, call in connections(self._members(group)):
                try:
                    await self._call(pod.node, call)
                except RceError as error:  # its agent serves it again later, or it has ended
                    log.info("{name} was not connected to its group: {error}", name=pod.spec.name, error=str(error))
            turns.told = asked


def connections(members: Sequence[Pod]) -> list[tuple[Pod, ConnectGroup]]:
    """Return for each member of a group what its agent must know."""
    named: dict[str, str] = {}
    for pod in members:
        assert pod.spec.group is not None
        named |= pod.spec.group.members
    own = {pod.spec.name.partition("/")[2]: pod.spec.group.address for pod in members if pod.spec.group is not None}
    named |= own
    return [
        (
            pod,
            ConnectGroup(
                pod.run, named, sorted(other.address for other in members if other is not pod and other.address)
            ),
        )
        for pod in members
    ]
