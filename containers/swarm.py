"""The engine `swarm`: an environment is a service of one task, which Docker Swarm places on one of many machines.

Swarm never starts a task again: a new life of an environment has a new run and a new token, so it is a new service. An
end is noticed by the agent on the task's node (agent.py), which the engine itself keeps on every node and which serves
the environments' sockets there; that a node is drained or gone is told by the manager. Both are reported as the end of
the environments there, and the Master's next life of each is placed on another node.

A service cannot be without a network, so each has one of its own that leads nowhere.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from weakref import WeakValueDictionary

from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from containers.data_relay import GATE
from containers.docker_daemon import RUN, SIZE
from containers.docker_events import Event
from containers.docker_networks import ENVIRONMENT, GROUP, group_network
from containers.docker_options import CONTROL, Size, limits, reference
from containers.engine import Ended, Engine, Life
from containers.settings import is_local
from containers.swarm_agents import Agents, Kept
from containers.swarm_manager import AGENT, Found, Manager, Network, Node
from containers.swarm_spec import FEATURE, AgentService, Names, agent_task, check, environment_task, surroundings
from rce import __version__
from rce.calls import ContainerEnded, EnvironmentSpec, Used
from rce.errors import InvalidRequest, NoCapacity, StartFailed, TimedOut, Unavailable
from rce.tls import Tls

log = Logger()
COMMAND: Sequence[str] = ("python3", "-P", "-m", "endpoints.environment")
AGENTS_TIMEOUT = 30.0  # seconds for the agents to come up when the engine opens
START_TIMEOUT = 120.0  # for a task to run
END_TIMEOUT = 30.0  # for a task to end that was told to
SECOND_LOOK = 3.0  # after this Swarm knows what an agent knew before


@dataclass
class _Place:
    """Where a life of an environment is; `node` is empty until it is known."""

    run: str
    node: str = ""
    last_lines: Sequence[str] = ()


class SwarmEngine(Engine):
    """Environments as services of `image` on the swarm that DOCKER_HOST is a manager of.

    `features` are those of every node; a node has more by its labels (rce.feature.NAME=true). `read_only` are
    directories that every node has and every environment sees. With `stay` the agents outlive the engine.
    """

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[Ended], None],
        *,
        reactor: ReactorBase,
        platform: str,
        directory: Path,
        master: str,
        image: str,
        settings: Mapping[str, str],
        agent: AgentService,
        tls: Tls | None = None,
        stay: bool = True,
        read_only: Sequence[str] = (),
        command: Sequence[str] = COMMAND,
    ) -> None:
        super().__init__(capacity, features, ended)
        self._reactor = reactor
        self._file = directory / "swarm.json"
        self._master = master
        self._image = image
        self._settings = settings
        self._agent = agent
        self._tls = tls
        self._stay = stay
        self._read_only = read_only
        self._command = command
        self._everywhere = frozenset(features)
        self._labels = {"rce.platform": platform, "rce.directory": str(directory)}
        self._agent_name = f"rce-agent-{Names.of(self._labels, '', '').owner}"
        self._manager = Manager(self._labels)
        self._agents: Agents
        self._nodes: dict[str, Node] = {}
        self._places: dict[str, _Place] = {}
        self._looking: set[asyncio.Task[None]] = set()
        self._tidying: set[asyncio.Task[None]] = set()  # what is removed while nobody waits for it
        self._following = asyncio.Event()
        self._network_locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    @property
    def relays(self) -> list[str]:
        return [f"relay:{address}" for address in self._agents.relays]

    def know(self, relays: Collection[str]) -> None:
        self._agents.know(relays)

    async def launch(self, spec: EnvironmentSpec) -> None:
        check(spec)
        granted = limits(spec, [], self._largest())
        image, constraints = self._fit(spec)
        names = Names.of(self._labels, spec.name, spec.run)
        service = f"rce-{spec.run}-{secrets.token_hex(4)}"  # what is left of a service keeps its name for some seconds
        labels = {ENVIRONMENT: spec.name, RUN: spec.run, SIZE: str(spec.options.size)}
        network = Network(service)
        if spec.group is not None:
            network = Network(group_network(self._labels, spec.group.name), spec.group.subnet)
            labels[GROUP] = network.name
        values = surroundings(spec, names, {**self._settings, "relay": f"{CONTROL}/{GATE}"})
        task = environment_task(
            spec,
            granted,
            names,
            image,
            self._command,
            values,
            {**self._labels, **labels},
            constraints,
            self._read_only,
            network.name,
        )
        place = self._places[spec.name] = _Place(spec.run)
        async with self._lock_of(network.name):
            await self._manager.make(service, task, labels, network)
        try:
            async with asyncio.timeout(START_TIMEOUT):
                place.node = await self._manager.running(spec.name, service)
        except TimeoutError:
            raise StartFailed(
                f"environment {spec.name} did not start: no node has run it within {START_TIMEOUT:g} s"
            ) from None

    def _largest(self) -> Size:
        sizes = [node.size for node in self._nodes.values() if node.usable] or [Size.here()]
        return Size(max(size.cores for size in sizes), max(size.memory for size in sizes))

    async def remove(self, name: str) -> None:
        for found in await self._manager.present(name):
            await self._remove_life(found)
        self._places.pop(name, None)

    async def recover(self) -> dict[str, Life]:
        """Raises Unavailable when there is no manager of a swarm, InvalidRequest when its nodes reach no Master."""
        await self._manager.connect(self._happened, self._taken_up)
        await self._following.wait()  # before the list is made, so that no end is missed
        await self._survey()
        await self._open_agents()
        lives: dict[str, Life] = {}
        wanted: set[str] = set()
        for found in await self._manager.present():
            if self._runs(found):
                wanted.add(found.network)
                self._places[found.name] = _Place(found.run, found.node)
                lives[found.name] = Life(found.run, found.size)
            else:
                log.info("removing what is left of {name}", name=found.name)
                await self._remove_life(found)
        for network in await self._manager.networks():
            if network not in wanted:
                await self._manager.remove_network(network)
        return lives

    async def last_lines(self, name: str) -> list[str]:
        return list(self._places[name].last_lines)

    async def usage(self) -> dict[str, Used]:
        found = await self._agents.usage()
        return {name: found[name] for name in self.running() if name in found}

    async def release(self) -> None:
        self._manager.close()
        for task in self._looking:
            task.cancel()
        if self._tidying:
            await asyncio.wait(self._tidying)
        if hasattr(self, "_agents"):
            await self._agents.close()
        if not self._stay and not self._places:
            await self._manager.remove(self._agent_name)
            await self._no_task(self._agent_name)
        self._places.clear()

    # --- nodes and their agents ---------------------------------------------------------------------------------------

    async def _open_agents(self) -> None:
        usable = {node.id for node in self._nodes.values() if node.usable}
        if is_local(self._master) and len(self._nodes) > 1:
            raise InvalidRequest(
                f"the swarm has {len(self._nodes)} nodes, and {self._master} is not an address at which they reach the "
                "Master: give one that they do",
                field="master",
            )
        kept = Kept.load(self._file)
        self._agents = Agents(kept.secret, self._reported, self._container_ended)
        address = self._agent.address or self._manager.address
        try:
            port = await self._agents.listen(self._reactor, f"tcp:{kept.port}:interface={address}", self._tls)
        except OSError as error:
            raise Unavailable(f"the agents of the swarm cannot be taken at {address}: {error}") from None
        Kept(kept.secret, port).store(self._file)
        image = await self._manager.image(self._agent.image) or self._agent.image
        known = {
            "RCE_MASTER": self._master,
            "RCE_TASK_SET": f"tcp:{address}:{port}",
            "RCE_TOKEN": kept.secret,
            "RCE_PLATFORM": self._labels["rce.platform"],
            "RCE_DIRECTORY": self._labels["rce.directory"],
        }
        labels = {**self._labels, AGENT: "yes"}
        task = agent_task(self._agent, image, known, labels, self._manager.volumes, self._tls)
        await self._manager.keep_agents(self._agent_name, task)
        lacking = await self._agents.wait_for(usable, AGENTS_TIMEOUT)
        for node in lacking:
            reason = await self._manager.failure(self._agent_name, node)
            name = self._nodes[node].name
            log.warn("node {node} takes no environments: its agent does not come up: {why}", node=name, why=reason)
        if lacking and lacking == usable:
            raise Unavailable(
                f"no agent comes up on the swarm ({reason}); `provisioning/provision image` makes their image"
            )

    def _fit(self, spec: EnvironmentSpec) -> tuple[str, list[str]]:
        """The image as it is on most nodes, and the constraints that lead to one of these. StartFailed, NoCapacity."""
        tag = reference(spec.options.image) if spec.options.image else self._image
        image = self._agents.image(tag)
        if image is None:
            raise StartFailed(
                f"environment {spec.name} did not start: no node of the swarm has an image {tag} for RCE "
                f"{__version__}; `provisioning/provision image` builds those of the platform, "
                "`docker save | docker load` spreads them"
            )
        wanted = set(spec.options.specialFeatures) - self._everywhere
        usable = [node for node in self._nodes.values() if node.usable]
        unfit = [node for node in usable if not self._agents.has(node.id, image)]
        if not any(wanted <= node.features for node in usable if node not in unfit):
            able = ", ".join(sorted(node.name for node in usable if wanted <= node.features)) or "none"
            raise NoCapacity(
                f"environment {spec.name}: of the nodes with its special features ({able}) none has the image {tag} as "
                "most others have it (`docker save | docker load` spreads it), and an agent"
            )
        avoided = [f"node.id!={node.id}" for node in unfit]
        return image, avoided + [f"{FEATURE}{feature}==true" for feature in sorted(wanted)]

    def _runs(self, found: Found) -> bool:
        node = self._nodes.get(found.node)
        report = self._agents.report(node.id) if node else None
        if node is None or not node.usable:
            return False
        return found.running if report is None else found.run in report.runs

    # --- ends ---------------------------------------------------------------------------------------------------------

    async def _remove_life(self, found: Found) -> None:
        """Its agent ends a task at once; Swarm alone would wait for two seconds. It may not have begun, so Swarm
        is waited for where the agent finds nothing. A node without an agent is cleared by the next one there."""
        await self._manager.remove(found.service)
        node = self._nodes.get(found.node)
        if not found.node or node is None:
            cleared = await self._agents.clear_everywhere(found.run)
        else:
            cleared = not node.usable or await self._agents.clear(found.node, found.run)
        if not cleared:
            await self._no_task(found.service)
            await self._agents.clear_everywhere(found.run)
        self._look(self._remove_network(found.network), self._tidying)

    async def _remove_network(self, name: str) -> None:
        """That of a group goes with its last member."""
        async with self._lock_of(name):
            if all(found.network != name for found in await self._manager.present()):
                await self._manager.remove_network(name)

    def _lock_of(self, network: str) -> asyncio.Lock:
        lock = self._network_locks.get(network)
        if lock is None:
            lock = self._network_locks[network] = asyncio.Lock()
        return lock

    async def _no_task(self, service: str) -> None:
        try:
            async with asyncio.timeout(END_TIMEOUT):
                await self._manager.ended(service, [node.id for node in self._nodes.values() if node.usable])
        except TimeoutError:
            raise TimedOut(f"the task of {service} does not end within {END_TIMEOUT:g} s") from None

    def _container_ended(self, ended: ContainerEnded) -> None:
        name = next((name for name, place in self._places.items() if place.run == ended.run), None)
        if name is not None:
            self._places[name].last_lines = ended.lines
            self.died(name, ended.run, ended.reason, ended.status)

    def _reported(self, node: str) -> None:
        report = self._agents.report(node)
        if report is None:
            return
        if not report.protected:
            log.warn(
                'Docker on node {node} lets containers gain privileges: put "no-new-privileges": true in its '
                "/etc/docker/daemon.json",
                node=self._nodes[node].name if node in self._nodes else node,
            )
        for name, place in self._places.items():
            if place.node == node and place.run not in report.runs:
                self._look(self._check(name, place.run))

    async def _check(self, name: str, run: str) -> None:
        """An agent does not see an environment: it had ended while no agent was there, or it has only just begun."""
        await asyncio.sleep(SECOND_LOOK)
        if not any(found.run == run and found.running for found in await self._manager.present(name)):
            self.died(name, run, "it ended while its node had no agent", None)

    def _happened(self, event: Event) -> None:
        self._look(self._survey())

    def _taken_up(self) -> None:
        if self._following.is_set():
            self._look(self._survey())
        self._following.set()

    async def _survey(self) -> None:
        """Which nodes there are, and the end of all environments on those that Swarm does not use."""
        self._nodes = await self._manager.nodes()
        usable = [node for node in self._nodes.values() if node.usable]
        self.features = self._everywhere.union(*(node.features for node in usable))
        self.gpus = sum(node.gpus for node in usable)
        for name, place in list(self._places.items()):
            node = self._nodes.get(place.node)
            if place.node and (node is None or not node.usable):
                self.died(name, place.run, node.why if node else "its node has left the swarm", None)

    def _look(self, work: Coroutine[None, None, None], among: set[asyncio.Task[None]] | None = None) -> None:
        tasks = self._looking if among is None else among
        task = asyncio.create_task(work)
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        task.add_done_callback(self._looked)

    def _looked(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()):
            log.error("the swarm could not be asked: {error}", error=str(error))
