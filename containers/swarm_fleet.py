"""The nodes of a swarm with their agents: which can take environments, and which an environment fits on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.logger import Logger

from containers.docker_options import reference
from containers.limits import Size
from containers.settings import is_local
from containers.swarm_agents import Agents, Kept
from containers.swarm_images import NAME, USER, ImageRegistry
from containers.swarm_manager import Manager, Node
from containers.swarm_spec import AGENT, FEATURE, AgentService, Names, agent_task
from rce import __version__
from rce.calls.agents import HaveImage
from rce.calls.environments import EnvironmentSpec
from rce.control import Handlers
from rce.errors import InvalidRequest, NoCapacity, RceError, StartFailed, Unavailable
from rce.tls import Tls

log = Logger()
REPORT_TIMEOUT = 10.0  # for an agent to see what was brought
AGENTS_TIMEOUT = 30.0  # seconds for the agents to come up when the engine opens


class Fleet:
    """`labels` are those of all that the task set makes, `features` those of every node; a node has more by its own
    labels. What agents have to know of their task set is kept in `file`."""

    def __init__(
        self,
        manager: Manager,
        labels: Mapping[str, str],
        features: Collection[str],
        file: Path,
        agent: AgentService,
        tls: Tls | None,
    ) -> None:
        self.service = f"rce-agent-{Names.of(labels, '', '').owner}"
        self.nodes: dict[str, Node] = {}
        self.agents: Agents
        self._manager = manager
        self._labels = labels
        self._everywhere = frozenset(features)
        self._file = file
        self._agent = agent
        self._tls = tls
        self._images = file.with_name("images")
        self._registry: ImageRegistry
        self._known: dict[str, str]  # what agents are told
        self._open = False
        self._shared = False  # whether nodes take the agents' image from here
        self._fetching: dict[tuple[str, str], asyncio.Task[None]] = {}  # by node and id of the image
        self._exporting = asyncio.Lock()

    @property
    def usable(self) -> dict[str, Node]:
        """The nodes on which Swarm keeps tasks."""
        return {id: node for id, node in self.nodes.items() if node.usable}

    @property
    def features(self) -> frozenset[str]:
        return self._everywhere.union(*(node.features for node in self.usable.values()))

    @property
    def gpus(self) -> int:
        return sum(node.gpus for node in self.usable.values())

    @property
    def largest(self) -> Size:
        """The most cores, and the most memory, that a node has."""
        sizes = [node.size for node in self.usable.values()] or [Size.here()]
        return Size(max(size.cores for size in sizes), max(size.memory for size in sizes))

    async def survey(self) -> None:
        """See which nodes there are."""
        self.nodes = await self._manager.nodes()
        if self._open and len(self.nodes) > 1 and not self._shared:
            await self._keep_agents()

    async def open(
        self,
        reactor: ReactorBase,
        master: str,
        reported: Callable[[str], None],
        handlers: Callable[[Handlers], None],
    ) -> None:
        """Have an agent on each node. Unavailable, InvalidRequest when the nodes reach no Master."""
        if is_local(master) and len(self.nodes) > 1:
            raise InvalidRequest(
                f"the swarm has {len(self.nodes)} nodes, and {master} is not an address at which they reach the "
                "Master: give one that they do",
                field="master",
            )
        kept = Kept.load(self._file)
        self.agents = Agents(kept.secret, reported, handlers)
        self._registry = ImageRegistry(self._images, kept.secret)
        address = self._agent.address or self._manager.address
        try:
            port = await self.agents.listen(reactor, f"tcp:{kept.port}:interface={address}", self._tls)
            images = await self._registry.listen(reactor, address, kept.images, self._tls)
        except (OSError, CannotListenError) as error:
            raise Unavailable(f"the agents of the swarm cannot be taken at {address}: {error}") from None
        await self._manager.forget(self._images)
        Kept(kept.secret, port, images).store(self._file)
        self._known = {"RCE_MASTER": master, "RCE_TASK_SET": f"tcp:{address}:{port}", "RCE_TOKEN": kept.secret}
        await self._keep_agents()
        self._open = True
        await self._miss_agents()

    async def close(self) -> None:
        for task in self._fetching.values():
            task.cancel()
        if hasattr(self, "agents"):
            await self.agents.close()
            self._registry.close()

    async def _keep_agents(self) -> None:
        """On one node its image is there; others take it from here."""
        self._shared = len(self.nodes) > 1
        image = await self._manager.image(reference(self._agent.image)) or self._agent.image
        if self._shared and image.startswith("sha256:"):
            try:
                await self._manager.sign_in(self._registry.address, USER, self._registry.secret)
            except Unavailable as error:
                raise Unavailable(
                    f"Docker here takes no images from {self._registry.address}, so other nodes would not ({error}); "
                    "`provisioning/provision swarm` writes the insecure-registries of /etc/docker/daemon.json"
                ) from None
            image = await self._source(image)
        whose = {f"RCE_{key.partition('.')[2].upper()}": value for key, value in self._labels.items()}
        labels = {**self._labels, AGENT: "yes"}
        task = agent_task(self._agent, image, {**self._known, **whose}, labels, self._manager.root, self._tls)
        await self._manager.keep_agents(self.service, task)

    async def _miss_agents(self) -> None:
        """Wait a while, and say whose does not come."""
        lacking = await self.agents.wait_for(self.usable, AGENTS_TIMEOUT)
        reason = ""
        for node in lacking:
            reason = await self._manager.failure(self.service, node)
            name = self.nodes[node].name
            log.warn("node {node} takes no environments yet: its agent is not up: {why}", node=name, why=reason)
        if lacking and lacking == set(self.usable):
            raise Unavailable(
                f"no agent comes up on the swarm ({reason}); `provisioning/provision image` makes their image"
            )

    async def _source(self, image: str) -> str:
        """Where nodes take an image from."""
        async with self._exporting:
            return f"{self._registry.address}/{NAME}@{await self._manager.export(image, self._images)}"

    # --- images -------------------------------------------------------------------------------------------------------

    async def spread(self, tag: str) -> str | None:
        """Have nodes take an image that they lack; returns its id: as the manager's node has it, else as most have it.

        None if no node has it.
        """
        id = await self._manager.image(tag)
        if id is None:
            return self.agents.image(tag)
        for node in self.usable:
            if self.agents.report(node) is not None and not self.agents.has(node, id):
                self._fetch(node, tag, id)
        return id

    def _fetch(self, node: str, tag: str, id: str) -> None:
        if (node, id) in self._fetching:
            return
        task = self._fetching[node, id] = asyncio.create_task(self._have(node, tag, id))
        task.add_done_callback(lambda _: self._fetching.pop((node, id)))

    async def _have(self, node: str, tag: str, id: str) -> None:
        try:
            source = await self._source(id)
            await self.agents.have_image(node, HaveImage(tag, source, USER, self._registry.secret))
            await self.agents.until(lambda: self.agents.has(node, id), REPORT_TIMEOUT)
            log.info("node {node} has {tag} now", node=self.nodes[node].name, tag=tag)
        except RceError as error:
            log.warn("node {node} lacks {tag}: {error}", node=self.nodes[node].name, tag=tag, error=str(error))

    async def fit(self, spec: EnvironmentSpec, image: str) -> tuple[str, list[str]]:
        """An image, and the constraints that lead to a node that has it; waits for one that is just getting it.

        StartFailed, NoCapacity.
        """
        tag = reference(spec.options.image or image)
        id = await self.spread(tag)
        if id is None:
            raise StartFailed(
                f"environment {spec.name} did not start: no node of the swarm has an image {tag} for RCE "
                f"{__version__}; `provisioning/provision image` builds those of the platform"
            )
        wanted = set(spec.options.specialFeatures) - self._everywhere
        able = {node.id for node in self.usable.values() if wanted <= node.features}
        while not any(self.agents.has(node, id) for node in able):
            coming = [task for (node, of), task in self._fetching.items() if node in able and of == id]
            if not coming:
                names = ", ".join(sorted(self.nodes[node].name for node in able)) or "none"
                raise NoCapacity(
                    f"environment {spec.name}: of the nodes with its special features ({names}) none has an agent and "
                    f"the image {tag} as the manager has it"
                )
            await asyncio.wait(coming, return_when=asyncio.FIRST_COMPLETED)
        avoided = [f"node.id!={node}" for node in self.usable if not self.agents.has(node, id)]
        return id, avoided + [f"{FEATURE}{feature}==true" for feature in sorted(wanted)]

    async def clear(self, node: str, run: str) -> bool:
        """Have all of an environment removed from its node, or from whichever has it. Whether it was found, or the
        node is not one of Swarm's at present: then the next agent there clears it."""
        if node not in self.nodes:
            return await self.agents.clear_everywhere(run)
        return not self.nodes[node].usable or await self.agents.clear(node, run)
