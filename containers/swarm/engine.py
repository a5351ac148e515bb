"""The engine `swarm`: each environment is a service of one task, which Docker Swarm places on one of many machines.

Swarm never restarts a task: a restarted environment has a new run and a new token, so it is a new service. The engine
runs an agent on every node (agent.py), which serves the sockets of the environments there and reports their ends. The
manager reports that a node was drained or lost, which also ends the environments there; the Master then starts a new
run of each, which Swarm places on another node.

Swarm does not support services without a network, so each service has an internal network of its own.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Collection, Coroutine, Sequence
from dataclasses import dataclass

from twisted.logger import Logger

from containers.agents.fleet import FleetEngine
from containers.agents.placements import Placement
from containers.data_relay import GATE
from containers.docker.daemon import RUN, SIZE
from containers.docker.events import Event
from containers.docker.networks import ENVIRONMENT, GROUP, group_network
from containers.docker.setup import Setup
from containers.endpoint import CONTROL, reference
from containers.engine import EnvironmentEnded, RunningEnvironment
from containers.limits import limits
from containers.swarm.fleet import Fleet
from containers.swarm.manager import Found, Manager, Network
from containers.swarm.spec import SOCKETS, AgentService, Names, check, environment_task, task_variables
from rce.control.calls.agents import ContainerEnded, EnvironmentUnusable
from rce.control.calls.call import Nothing
from rce.control.calls.environments import EnvironmentSpec, FetchPackage
from rce.control.calls.watching import EnvironmentUsage
from rce.control.connection import Handlers
from rce.errors import RceError, StartFailed, TimedOut
from rce.process.metrics import Family

log = Logger()
START_TIMEOUT = 120.0  # seconds for a task to run
END_TIMEOUT = 30.0  # seconds for a task to end after its service was removed
RECHECK_DELAY = 3.0  # seconds until the manager knows what an agent knew before


@dataclass
class _Placement(Placement):
    """Placement on a node, empty until Swarm has chosen one."""

    node: str = ""
    last_lines: Sequence[str] = ()


class SwarmEngine(FleetEngine):
    """Runs environments as services on the swarm that DOCKER_HOST is a manager of.

    `features` are those of every node; a node has more by its labels (rce.feature.NAME=true). With `keep_agents` the
    agents keep running when the engine is closed.
    """

    fetches_packages = True
    sockets = f"{SOCKETS}/{{run}}.sock"
    _fleet: Fleet

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[EnvironmentEnded], None],
        setup: Setup,
        *,
        agent: AgentService,
        keep_agents: bool = True,
    ) -> None:
        """Prepare the engine; arguments are as in `containers.settings.Settings`."""
        super().__init__(capacity, features, ended)
        self._setup = setup
        self._keep_agents = keep_agents
        self._nameservers = agent.nameservers
        self._manager = Manager(setup.labels)
        self._fleet = Fleet(self._manager, setup.labels, features, setup.directory / "swarm.json", agent, setup.tls)
        self._placements: dict[str, _Placement] = {}  # by name
        self._background: set[asyncio.Task[object]] = set()
        self._removals: set[asyncio.Task[object]] = set()  # of networks; `release` waits for them
        self._following = asyncio.Event()  # set when Docker's event stream has begun

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Create the service and wait until an agent serves its environment."""
        check(spec)
        granted = limits(spec, [], self._fleet.largest)
        image, constraints = await self._fleet.fit(spec, self._setup.image)
        names = Names.of(self._setup.labels, spec.name, spec.run)
        service = f"rce-{spec.run}-{secrets.token_hex(4)}"  # a removed service keeps its name for some seconds
        identity = {ENVIRONMENT: spec.name, RUN: spec.run, SIZE: str(spec.options.size)}
        labels = dict(identity)
        network = Network(service)
        if spec.group is not None:
            network = Network(group_network(self._setup.labels, spec.group.name), spec.group.subnet)
            labels[GROUP] = network.name
            await self._fleet.agents.set_group_members(spec.group)
        values = task_variables(spec, names, {**self._setup.settings, "relay": f"{CONTROL}/{GATE}"})
        task = environment_task(
            spec,
            granted,
            names,
            image,
            self._setup.command,
            values,
            {**self._setup.labels, **identity},
            constraints,
            self._setup.read_only,
            network.name,
            self._nameservers,
        )
        placement = self._placements[spec.name] = _Placement(spec.run)
        await self._manager.create_service(service, task, labels, network)
        try:
            async with asyncio.timeout(START_TIMEOUT):
                placement.node = await self._manager.wait_until_running(spec.name, service)
                await placement.settled
        except TimeoutError:
            raise StartFailed(
                f"environment {spec.name} did not start: no node has run it within {START_TIMEOUT:g} s"
            ) from None

    async def remove(self, name: str) -> None:
        """Remove all services of an environment, and what their tasks left on nodes."""
        for found in await self._manager.present(name):
            await self._remove_service(found)
        self._placements.pop(name, None)

    async def recover(self) -> dict[str, RunningEnvironment]:
        """Start the agents, adopt running services and remove the rest.

        Raises:
            Unavailable: DOCKER_HOST is not a manager of a swarm, or no agent joins.
            InvalidRequest: The nodes cannot reach the Master at its address.
        """
        await self._manager.connect(self._on_event, self._on_resumed)
        await self._following.wait()  # before services are listed, so that no end is missed
        await self._survey()
        await self._fleet.open(self._setup.reactor, self._setup.master, self._reported, self._add_handlers)
        adopted: dict[str, RunningEnvironment] = {}
        used_networks: set[str] = set()
        for found in await self._manager.present():
            if self._runs(found):
                used_networks.add(found.network)
                placement = self._placements[found.name] = _Placement(found.run, found.node)
                placement.settle()
                adopted[found.name] = RunningEnvironment(found.run, found.size)
            else:
                log.info("removing the remains of {name}", name=found.name)
                await self._remove_service(found)
        for network in await self._manager.networks():
            if network not in used_networks:
                await self._manager.remove_network(network)
        return adopted

    async def last_lines(self, name: str) -> list[str]:
        """Return the last lines of output that the agent has reported."""
        return list(self._placements[name].last_lines)

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the resources that environments have used on all nodes."""
        found = await self._fleet.agents.usage()
        return {name: found[name] for name in self.running() if name in found}

    async def metrics(self) -> dict[str, list[Family]]:
        """Return the metrics of the agents by node."""
        return await self._fleet.agents.metrics()

    async def release(self) -> None:
        """Disconnect from the manager and the agents; remove the agents too if they are not to be kept."""
        self._manager.close()
        for task in self._background:
            task.cancel()
        if self._removals:
            await asyncio.wait(self._removals)
        await self._fleet.close()
        if not self._keep_agents and not self._placements:
            await self._manager.remove_service(self._fleet.service)
            await self._wait_until_ended(self._fleet.service)
        self._placements.clear()

    def _runs(self, found: Found) -> bool:
        """Return True if a service's environment runs, as its node's agent reports or else as the manager does."""
        if found.node not in self._fleet.usable:
            return False
        report = self._fleet.agents.report(found.node)
        return found.running if report is None else found.run in report.runs

    # --- ends ---------------------------------------------------------------------------------------------------------

    async def _remove_service(self, found: Found) -> None:
        """Remove a service and what its task left.

        The agent ends the task at once, where Swarm alone would wait two seconds. If the agent finds no container, the
        task may not have started yet, so wait until Swarm has ended it.
        """
        await self._manager.remove_service(found.service)
        if not await self._fleet.remove_run(found.node, found.run):
            await self._wait_until_ended(found.service)
            await self._fleet.agents.remove_run_everywhere(found.run)
        self._spawn_into(self._removals, self._manager.remove_unused_network(found.network))

    async def _wait_until_ended(self, service: str) -> None:
        try:
            async with asyncio.timeout(END_TIMEOUT):
                await self._manager.wait_until_ended(service, list(self._fleet.usable))
        except TimeoutError:
            raise TimedOut(f"the task of {service} has not ended within {END_TIMEOUT:g} s") from None

    # --- calls of agents ----------------------------------------------------------------------------------------------

    def _add_handlers(self, handlers: Handlers) -> None:
        handlers.on(ContainerEnded, self._container_ended)
        handlers.on(EnvironmentUnusable, self._unusable)
        handlers.on(FetchPackage, lambda call: self.request_ticket(call.digest))

    def _placement(self, run: str) -> tuple[str, _Placement] | None:
        """Return the name and the placement of a run."""
        return next(((name, each) for name, each in self._placements.items() if each.run == run), None)

    async def _container_ended(self, ended: ContainerEnded) -> Nothing:
        if found := self._placement(ended.run):
            name, placement = found
            placement.last_lines = ended.lines
            placement.settle()
            self.report_end(name, ended.run, ended.reason, ended.status)
        return Nothing()

    async def _unusable(self, unusable: EnvironmentUnusable) -> Nothing:
        if found := self._placement(unusable.run):
            name, placement = found
            if not placement.settle(RceError.from_info(unusable.error)):
                self.report_end(name, unusable.run, unusable.error.message, None)
        return Nothing()

    def _reported(self, node: str) -> None:
        report = self._fleet.agents.report(node)
        if report is None:
            return
        if not report.protected:
            log.warn(
                'Docker on node {node} lets containers gain privileges: put "no-new-privileges": true in its '
                "/etc/docker/daemon.json",
                node=self._fleet.nodes[node].name if node in self._fleet.nodes else node,
            )
        self.on_relays()
        # Distribute the default image early, so that most environments need not wait for a pull.
        self._spawn_into(self._background, self._fleet.distribute(reference(self._setup.image)))
        for name, placement in self._placements.items():
            if placement.run in report.runs:
                placement.settle()
            elif placement.node == node and placement.settled.done():
                self._spawn_into(self._background, self._check_missing(name, placement.run))

    async def _check_missing(self, name: str, run: str) -> None:
        """Report the end of an environment that an agent lacks, unless it has only just started.

        It has then ended while its node had no agent.
        """
        await asyncio.sleep(RECHECK_DELAY)
        if not any(found.run == run and found.running for found in await self._manager.present(name)):
            self.report_end(name, run, "it ended while its node had no agent", None)

    def _on_event(self, event: Event) -> None:
        self._spawn_into(self._background, self._survey())

    def _on_resumed(self) -> None:
        if self._following.is_set():
            self._spawn_into(self._background, self._survey())
        self._following.set()

    async def _survey(self) -> None:
        """Update the nodes, and report the ends of all environments on nodes that Swarm does not use."""
        await self._fleet.survey()
        self.features = self._fleet.features
        self.gpus = self._fleet.gpus
        for name, placement in list(self._placements.items()):
            node = self._fleet.nodes.get(placement.node)
            if placement.node and (node is None or not node.usable):
                reason = node.unusable_reason if node else "its node has left the swarm"
                if not placement.settle(StartFailed(f"environment {name} did not start: {reason}")):
                    self.report_end(name, placement.run, reason, None)

    def _spawn_into(self, tasks: set[asyncio.Task[object]], work: Coroutine[None, None, object]) -> None:
        task = asyncio.create_task(work)
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        task.add_done_callback(self._background_done)

    def _background_done(self, task: asyncio.Task[object]) -> None:
        if not task.cancelled() and (error := task.exception()):
            log.error("a request to the swarm failed: {error}", error=str(error))
