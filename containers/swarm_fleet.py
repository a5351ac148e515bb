"""The nodes of a swarm with their agents: which can take environments, and which an environment fits on."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from containers.docker_options import Size, reference
from containers.settings import is_local
from containers.swarm_agents import Agents, Kept
from containers.swarm_manager import Manager, Node
from containers.swarm_spec import AGENT, FEATURE, AgentService, Names, agent_task
from rce import __version__
from rce.calls import EnvironmentSpec
from rce.control import Handlers
from rce.errors import InvalidRequest, NoCapacity, StartFailed, Unavailable
from rce.tls import Tls

log = Logger()
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
        address = self._agent.address or self._manager.address
        try:
            port = await self.agents.listen(reactor, f"tcp:{kept.port}:interface={address}", self._tls)
        except OSError as error:
            raise Unavailable(f"the agents of the swarm cannot be taken at {address}: {error}") from None
        Kept(kept.secret, port).store(self._file)
        await self._keep_agents(
            {"RCE_MASTER": master, "RCE_TASK_SET": f"tcp:{address}:{port}", "RCE_TOKEN": kept.secret}
        )

    async def close(self) -> None:
        if hasattr(self, "agents"):
            await self.agents.close()

    async def _keep_agents(self, known: Mapping[str, str]) -> None:
        image = await self._manager.image(self._agent.image) or self._agent.image
        whose = {f"RCE_{key.partition('.')[2].upper()}": value for key, value in self._labels.items()}
        labels = {**self._labels, AGENT: "yes"}
        task = agent_task(self._agent, image, {**known, **whose}, labels, self._manager.root, self._tls)
        await self._manager.keep_agents(self.service, task)
        lacking = await self.agents.wait_for(self.usable, AGENTS_TIMEOUT)
        reason = ""
        for node in lacking:
            reason = await self._manager.failure(self.service, node)
            name = self.nodes[node].name
            log.warn("node {node} takes no environments: its agent does not come up: {why}", node=name, why=reason)
        if lacking and lacking == set(self.usable):
            raise Unavailable(
                f"no agent comes up on the swarm ({reason}); `provisioning/provision image` makes their image"
            )

    def fit(self, spec: EnvironmentSpec, image: str) -> tuple[str, list[str]]:
        """The image as it is on most nodes, and the constraints that lead to one of these. StartFailed, NoCapacity."""
        tag = reference(spec.options.image or image)
        id = self.agents.image(tag)
        if id is None:
            raise StartFailed(
                f"environment {spec.name} did not start: no node of the swarm has an image {tag} for RCE "
                f"{__version__}; `provisioning/provision image` builds those of the platform, "
                "`docker save | docker load` spreads them"
            )
        wanted = set(spec.options.specialFeatures) - self._everywhere
        unfit = [node for node in self.usable.values() if not self.agents.has(node.id, id)]
        if not any(wanted <= node.features for node in self.usable.values() if node not in unfit):
            able = ", ".join(sorted(node.name for node in self.usable.values() if wanted <= node.features)) or "none"
            raise NoCapacity(
                f"environment {spec.name}: of the nodes with its special features ({able}) none has the image {tag} as "
                "most others have it (`docker save | docker load` spreads it), and an agent"
            )
        avoided = [f"node.id!={node.id}" for node in unfit]
        return id, avoided + [f"{FEATURE}{feature}==true" for feature in sorted(wanted)]

    async def clear(self, node: str, run: str) -> bool:
        """Have all of an environment removed from its node, or from whichever has it. Whether it was found, or the
        node is not one of Swarm's at present: then the next agent there clears it."""
        if node not in self.nodes:
            return await self.agents.clear_everywhere(run)
        return not self.nodes[node].usable or await self.agents.clear(node, run)
