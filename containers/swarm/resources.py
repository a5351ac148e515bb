"""Resources that an environment of a swarm gets on the node where Swarm has placed it.

Its container already runs by then, but its endpoint waits for the socket to the Master, which the agent opens when all
resources are provided. So none of the user's programs ever runs without its limits. If a resource cannot be provided,
the agent reports that and the environment is removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from msgspec.structs import replace

from containers.agents.hosts import hosts
from containers.agents.outside_limits import LimitRequest
from containers.docker.networks import Networks, group_network
from containers.endpoint import environment_user
from containers.fetching import Fetcher
from containers.packages import PackageCache
from containers.swarm.node import NodeDaemon, Task
from containers.swarm.spec import Names
from rce.control.calls.environments import Group

DONE = "furnished"  # file in the control directory of an environment that has its resources


class ResourceProvider:
    """Provides the environments of one node with packages, networks, names and limits.

    `labels` are those of everything that the task set creates.
    """

    def __init__(self, daemon: NodeDaemon, labels: Mapping[str, str], networks: Networks, fetcher: Fetcher) -> None:
        self._daemon = daemon
        self._labels = labels
        self._networks = networks
        self._fetcher = fetcher
        self._groups: dict[str, dict[str, str]] = {}  # the newest members of each group

    async def provide(self, task: Task) -> None:
        """Provide all resources that an environment asks for, unless that was done before.

        Raises:
            NotFound: The Master does not have a package.
            InvalidRequest: The node cannot provide a resource.
            StartFailed: A resource could not be provided.
            Unavailable: Docker does not answer.
            OSError: The environment has ended meanwhile.
        """
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
            await self._daemon.set_group_address(task.run, network, spec.group.address)
        egress = await self._networks.join(replace(spec, group=None))
        for each in egress.networks:
            await self._daemon.join_network(task.run, each.network, each.address)
        if spec.group is not None:
            await self._update_hosts_file(task, spec.group)
        await self._apply_limits(task, names)
        done.touch()

    async def set_group_members(self, name: str, members: Mapping[str, str], tasks: list[Task]) -> None:
        """Set the members of a group, and update the hosts files of those among `tasks`."""
        self._groups[name] = dict(members)
        for task in tasks:
            if task.running and task.spec.group is not None and task.spec.group.name == name:
                await self._update_hosts_file(task, task.spec.group)

    async def _update_hosts_file(self, task: Task, group: Group) -> None:
        members = self._groups.get(group.name) or group.members
        file = await self._daemon.hosts_file(task.run)
        file.write_text(hosts(file.read_text(), group.subnet, members))  # in place, as Docker mounts this very file

    async def _apply_limits(self, task: Task, names: Names) -> None:
        options = task.spec.options
        request = LimitRequest(0, "", options.bandwidth, options.io, options.disk)
        if request.is_empty:
            return
        directory = await self._daemon.make_volume(names.disk, task) if options.disk else Path()
        process = await self._daemon.process_id(task.run)
        await self._daemon.apply_limits(
            replace(
                request,
                process=process,
                image_directory=str(directory.parent),
                disk_file=str(directory / "disk"),
                owner=environment_user(task.name),
            )
        )
