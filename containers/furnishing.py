"""What an environment of a swarm is given on the node where Swarm has placed it.

Its container runs by then, but its endpoint waits for the way to the Master, which its agent opens when all is there;
so nothing of its user's has run without its limits. What cannot be given is told, and the environment ends.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ipaddress import ip_address, ip_network
from pathlib import Path

from msgspec.structs import replace

from containers.docker_networks import Networks, group_network
from containers.fetching import Fetcher
from containers.hands import Work
from containers.packages import PackageCache
from containers.swarm_node import NodeDaemon, Task
from containers.swarm_spec import Names
from rce.calls.environments import Group

DONE = "furnished"  # a file in the environment's control directory


class Furnisher:
    """`labels` are those of all that the task set makes."""

    def __init__(self, daemon: NodeDaemon, labels: Mapping[str, str], networks: Networks, fetcher: Fetcher) -> None:
        self._daemon = daemon
        self._labels = labels
        self._networks = networks
        self._fetcher = fetcher
        self._groups: dict[str, dict[str, str]] = {}  # members of groups, as said last

    async def furnish(self, task: Task) -> None:
        """StartFailed, NotFound, Unavailable, InvalidRequest with the reason; OSError if it has ended meanwhile."""
        names = Names.of(self._labels, task.name, task.run)
        done = await self._daemon.volume(names.control) / DONE
        if done.exists():
            return
        spec = task.spec
        if spec.packages:
            cache = PackageCache(await self._daemon.volume(names.packages), self._fetcher.fetch)
            cache.open()
            await cache.provide(task.run, spec.packages)
        if spec.group is not None:
            network = group_network(self._labels, spec.group.name)
            await self._daemon.settle(task.run, network, spec.group.address)
        reach = await self._networks.join(replace(spec, group=None))
        for each in reach.networks:
            await self._daemon.join_network(task.run, each.network, each.address)
        if spec.group is not None:
            await self._introduce(task, spec.group)
        await self._limit(task, names)
        done.touch()

    async def know(self, name: str, members: Mapping[str, str], tasks: list[Task]) -> None:
        """A group has these members now; those here learn their names."""
        self._groups[name] = dict(members)
        for task in tasks:
            if task.running and task.spec.group is not None and task.spec.group.name == name:
                await self._introduce(task, task.spec.group)

    async def _introduce(self, task: Task, group: Group) -> None:
        members = self._groups.get(group.name) or group.members
        file = await self._daemon.hosts_file(task.run)
        file.write_text(hosts(file.read_text(), group.subnet, members))  # in place: it is mounted in the container

    async def _limit(self, task: Task, names: Names) -> None:
        options = task.spec.options
        work = Work(0, "", options.bandwidth, options.io, options.disk)
        if not work.any:
            return
        directory = await self._daemon.make_volume(names.disk, task) if options.disk else Path()
        process = await self._daemon.process(task.run)
        await self._daemon.lend_hands(
            replace(work, process=process, ground=str(directory.parent), file=str(directory / "disk"))
        )


def hosts(text: str, subnet: str, members: Mapping[str, str]) -> str:
    """A file of names with these of a group's members first, and no others of its subnet."""
    network = ip_network(subnet)
    lines = [line for line in text.splitlines() if not _within(line, network.__contains__)]
    return "".join(f"{line}\n" for line in [*(f"{members[tag]}\t{tag}" for tag in sorted(members)), *lines])


def _within(line: str, contains: Callable[[object], bool]) -> bool:
    address = line.split(maxsplit=1)[:1]
    try:
        return bool(address) and contains(ip_address(address[0]))
    except ValueError:
        return False
