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
from collections.abc import Callable, Collection, Coroutine, Sequence
from dataclasses import dataclass, field

from twisted.logger import Logger

from containers.data_relay import GATE
from containers.docker_daemon import RUN, SIZE
from containers.docker_events import Event
from containers.docker_networks import ENVIRONMENT, GROUP, group_network
from containers.docker_options import CONTROL, reference
from containers.docker_setup import Setup
from containers.engine import Ended, Engine, Life
from containers.limits import limits
from containers.swarm_fleet import Fleet
from containers.swarm_manager import Found, Manager, Network
from containers.swarm_spec import AgentService, Names, check, environment_task, surroundings
from rce.calls.agents import ContainerEnded, Unfit
from rce.calls.call import Nothing
from rce.calls.environments import EnvironmentSpec, FetchPackage
from rce.calls.watching import Used
from rce.control import Handlers
from rce.errors import RceError, StartFailed, TimedOut
from rce.metrics import Family

log = Logger()
START_TIMEOUT = 120.0  # seconds for a task to run
END_TIMEOUT = 30.0  # for a task to end that was told to
SECOND_LOOK = 3.0  # after this Swarm knows what an agent knew before


@dataclass
class _Place:
    """Where a life of an environment is; `node` is empty until it is known, `settled` is when its agent serves it."""

    run: str
    node: str = ""
    last_lines: Sequence[str] = ()
    settled: asyncio.Future[None] = field(default_factory=lambda: asyncio.get_running_loop().create_future())

    def settle(self, error: RceError | None = None) -> bool:
        """It has all that it needs, or will not have it; whether somebody waits to hear that."""
        if self.settled.done():
            return False
        if error is None:
            self.settled.set_result(None)
        else:
            self.settled.set_exception(error)
        return True


class SwarmEngine(Engine):
    """Environments as services on the swarm that DOCKER_HOST is a manager of.

    `features` are those of every node; a node has more by its labels (rce.feature.NAME=true). With `stay` the agents
    outlive the engine.
    """

    fetches = True

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[Ended], None],
        setup: Setup,
        *,
        agent: AgentService,
        stay: bool = True,
    ) -> None:
        super().__init__(capacity, features, ended)
        self._setup = setup
        self._stay = stay
        self._nameservers = agent.nameservers
        self._manager = Manager(setup.labels)
        self._fleet = Fleet(self._manager, setup.labels, features, setup.directory / "swarm.json", agent, setup.tls)
        self._places: dict[str, _Place] = {}
        self._looking: set[asyncio.Task[object]] = set()
        self._tidying: set[asyncio.Task[object]] = set()  # what is removed while nobody waits for it
        self._following = asyncio.Event()

    @property
    def relays(self) -> list[str]:
        return [f"relay:{address}" for address in self._fleet.agents.relays]

    def know(self, relays: Collection[str]) -> None:
        self._fleet.agents.know(relays)

    async def launch(self, spec: EnvironmentSpec) -> None:
        check(spec)
        granted = limits(spec, [], self._fleet.largest)
        image, constraints = await self._fleet.fit(spec, self._setup.image)
        names = Names.of(self._setup.labels, spec.name, spec.run)
        service = f"rce-{spec.run}-{secrets.token_hex(4)}"  # what is left of a service keeps its name for some seconds
        identity = {ENVIRONMENT: spec.name, RUN: spec.run, SIZE: str(spec.options.size)}
        labels = dict(identity)
        network = Network(service)
        if spec.group is not None:
            network = Network(group_network(self._setup.labels, spec.group.name), spec.group.subnet)
            labels[GROUP] = network.name
            await self._fleet.agents.introduce(spec.group)
        values = surroundings(spec, names, {**self._setup.settings, "relay": f"{CONTROL}/{GATE}"})
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
        place = self._places[spec.name] = _Place(spec.run)
        await self._manager.make(service, task, labels, network)
        try:
            async with asyncio.timeout(START_TIMEOUT):
                place.node = await self._manager.running(spec.name, service)
                await place.settled
        except TimeoutError:
            raise StartFailed(
                f"environment {spec.name} did not start: no node has run it within {START_TIMEOUT:g} s"
            ) from None

    async def remove(self, name: str) -> None:
        for found in await self._manager.present(name):
            await self._remove_life(found)
        self._places.pop(name, None)

    async def recover(self) -> dict[str, Life]:
        """Raises Unavailable when there is no manager of a swarm, InvalidRequest when its nodes reach no Master."""
        await self._manager.connect(self._happened, self._taken_up)
        await self._following.wait()  # before the list is made, so that no end is missed
        await self._survey()
        await self._fleet.open(self._setup.reactor, self._setup.master, self._reported, self._answer)
        lives: dict[str, Life] = {}
        wanted: set[str] = set()
        for found in await self._manager.present():
            if self._runs(found):
                wanted.add(found.network)
                place = self._places[found.name] = _Place(found.run, found.node)
                place.settle()
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
        found = await self._fleet.agents.usage()
        return {name: found[name] for name in self.running() if name in found}

    async def metrics(self) -> dict[str, list[Family]]:
        return await self._fleet.agents.metrics()

    async def release(self) -> None:
        self._manager.close()
        for task in self._looking:
            task.cancel()
        if self._tidying:
            await asyncio.wait(self._tidying)
        await self._fleet.close()
        if not self._stay and not self._places:
            await self._manager.remove(self._fleet.service)
            await self._no_task(self._fleet.service)
        self._places.clear()

    def _runs(self, found: Found) -> bool:
        if found.node not in self._fleet.usable:
            return False
        report = self._fleet.agents.report(found.node)
        return found.running if report is None else found.run in report.runs

    # --- ends ---------------------------------------------------------------------------------------------------------

    async def _remove_life(self, found: Found) -> None:
        """Its agent ends a task at once; Swarm alone would wait for two seconds. It may not have begun, so Swarm
        is waited for where the agent finds nothing."""
        await self._manager.remove(found.service)
        if not await self._fleet.clear(found.node, found.run):
            await self._no_task(found.service)
            await self._fleet.agents.clear_everywhere(found.run)
        self._look(self._manager.release(found.network), self._tidying)

    async def _no_task(self, service: str) -> None:
        try:
            async with asyncio.timeout(END_TIMEOUT):
                await self._manager.ended(service, list(self._fleet.usable))
        except TimeoutError:
            raise TimedOut(f"the task of {service} does not end within {END_TIMEOUT:g} s") from None

    # --- what agents say ----------------------------------------------------------------------------------------------

    def _answer(self, handlers: Handlers) -> None:
        handlers.on(ContainerEnded, self._container_ended)
        handlers.on(Unfit, self._unfit)
        handlers.on(FetchPackage, lambda call: self.ticket(call.digest))

    def _place(self, run: str) -> tuple[str, _Place] | None:
        return next(((name, place) for name, place in self._places.items() if place.run == run), None)

    async def _container_ended(self, ended: ContainerEnded) -> Nothing:
        if found := self._place(ended.run):
            name, place = found
            place.last_lines = ended.lines
            place.settle()
            self.died(name, ended.run, ended.reason, ended.status)
        return Nothing()

    async def _unfit(self, unfit: Unfit) -> Nothing:
        if found := self._place(unfit.run):
            name, place = found
            if not place.settle(RceError.from_info(unfit.error)):
                self.died(name, unfit.run, unfit.error.message, None)
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
        self._look(self._fleet.spread(reference(self._setup.image)))  # most environments need not wait for it then
        for name, place in self._places.items():
            if place.run in report.runs:
                place.settle()
            elif place.node == node and place.settled.done():
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
        await self._fleet.survey()
        self.features = self._fleet.features
        self.gpus = self._fleet.gpus
        for name, place in list(self._places.items()):
            node = self._fleet.nodes.get(place.node)
            if place.node and (node is None or not node.usable):
                why = node.why if node else "its node has left the swarm"
                if not place.settle(StartFailed(f"environment {name} did not start: {why}")):
                    self.died(name, place.run, why, None)

    def _look(self, work: Coroutine[None, None, object], among: set[asyncio.Task[object]] | None = None) -> None:
        tasks = self._looking if among is None else among
        task = asyncio.create_task(work)
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        task.add_done_callback(self._looked)

    def _looked(self, task: asyncio.Task[object]) -> None:
        if not task.cancelled() and (error := task.exception()):
            log.error("the swarm could not be asked: {error}", error=str(error))
