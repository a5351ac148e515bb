"""Nodes of a swarm and their agents: which nodes can take environments, and which of them fit an environment."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path

from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.logger import Logger

from containers.agents.connections import AgentAccess, Agents
from containers.agents.fleet import NodeFleet
from containers.docker.api import docker_host
from containers.endpoint import reference
from containers.ports import listen_again
from containers.settings import is_local
from containers.swarm.images import NAME, USER, ImageRegistry
from containers.swarm.manager import Manager, Node
from containers.swarm.spec import AGENT, FEATURE, AgentService, Names, agent_socket, agent_task
from rce import __version__
from rce.control.calls.agents import PullImage
from rce.control.calls.environments import EnvironmentSpec
from rce.control.connection import Handlers
from rce.errors import InvalidRequest, NoCapacity, RceError, StartFailed, Unavailable
from rce.net.tls import Tls

log = Logger()
REPORT_TIMEOUT = 10.0  # seconds for an agent to report an image that its node has pulled
AGENTS_TIMEOUT = 30.0  # seconds for the agents to join when the engine opens


class Fleet(NodeFleet[Node]):
    """The nodes of the swarm with their agents.

    `labels` mark everything that the task set creates. `features` are the special features of every node; a node has
    more by its own labels. The file `file` keeps the secret and the ports by which agents reach the task set.
    """

    def __init__(
        self,
        manager: Manager,
        labels: Mapping[str, str],
        features: Collection[str],
        file: Path,
        agent: AgentService,
        tls: Tls | None,
    ) -> None:
        super().__init__(features)
        self.service = f"rce-agent-{Names.of(labels, '', '').owner}"
        self._manager = manager
        self._labels = labels
        self._file = file
        self._agent = agent
        self._tls = tls
        self._images = file.with_name("images")
        self._registry: ImageRegistry
        self._agent_settings: dict[str, str]  # environment variables of the agents
        self._open = False
        self._serves_agent_image = False  # True if nodes pull the agents' image from the registry here
        self._pulls: dict[tuple[str, str], asyncio.Task[None]] = {}  # by node and id of the image
        self._exporting = asyncio.Lock()

    async def survey(self) -> None:
        """Update `nodes` from the manager."""
        self.nodes = await self._manager.nodes()
        if self._open and len(self.nodes) > 1 and not self._serves_agent_image:
            await self._update_agent_service()

    async def open(
        self,
        reactor: ReactorBase,
        master: str,
        reported: Callable[[str], None],
        add_handlers: Callable[[Handlers], None],
    ) -> None:
        """Run an agent on each node and wait for the agents to join.

        Raises:
            InvalidRequest: `master` is an address of this machine only, so the nodes cannot reach it.
            Unavailable: The address for the agents cannot be used, or no agent joins.
        """
        if is_local(master) and len(self.nodes) > 1:
            raise InvalidRequest(
                f"the swarm has {len(self.nodes)} nodes, and {master} is not an address at which they reach the "
                "Master: give one that they can reach",
                field="master",
            )
        access = AgentAccess.load(self._file)
        self.agents = Agents(access.secret, reported, add_handlers)
        self._registry = ImageRegistry(self._images, access.secret)
        address = self._agent.address or self._manager.address

        async def listen_for_agents(port: int) -> int:
            return await self.agents.listen(reactor, f"tcp:{port}:interface={address}", self._tls)

        try:
            port = await listen_again(listen_for_agents, access.port)
            images = await listen_again(partial(self._registry.listen, address, tls=self._tls), access.images)
        except (OSError, CannotListenError, Unavailable) as error:
            raise Unavailable(f"cannot listen for the agents of the swarm at {address}: {error}") from None
        await self._manager.sweep_exports(self._images)
        AgentAccess(access.secret, port, images).store(self._file)
        self._agent_settings = {
            "RCE_MASTER": master,
            "RCE_TASK_SET": f"tcp:{address}:{port}",
            "RCE_TOKEN": access.secret,
        }
        await self._update_agent_service()
        self._open = True
        await self._await_agents()

    async def close(self) -> None:
        """Stop serving the agents, which keep running."""
        for task in self._pulls.values():
            task.cancel()
        if hasattr(self, "agents"):
            await self.agents.close()
            await self._registry.close()

    async def _update_agent_service(self) -> None:
        """Create or update the service of the agents. On a swarm of several nodes they pull its image from here."""
        self._serves_agent_image = len(self.nodes) > 1
        image = await self._manager.image_id(reference(self._agent.image)) or self._agent.image
        if self._serves_agent_image and image.startswith("sha256:"):
            try:
                await self._manager.sign_in(self._registry.address, USER, self._registry.secret)
            except Unavailable as error:
                raise Unavailable(
                    f"Docker here pulls no images from {self._registry.address}, so other nodes would not ({error}); "
                    "`provisioning/provision swarm` writes the insecure-registries of /etc/docker/daemon.json"
                ) from None
            image = await self._image_source(image)
        own = {f"RCE_{key.partition('.')[2].upper()}": value for key, value in self._labels.items()}
        labels = {**self._labels, AGENT: "yes"}
        variables = {**self._agent_settings, **own}
        socket = agent_socket(docker_host(), len(self.nodes))
        task = agent_task(self._agent, image, variables, labels, self._manager.root, self._tls, socket)
        await self._manager.update_agent_service(self.service, task)

    async def _await_agents(self) -> None:
        """Wait for the agents to join and log which do not.

        Raises:
            Unavailable: No agent joins.
        """
        lacking = await self.agents.wait_for_reports(self.usable, AGENTS_TIMEOUT)
        reason = ""
        for node in lacking:
            reason = await self._manager.failure(self.service, node)
            name = self.nodes[node].name
            log.warn("node {node} takes no environments until its agent has joined: {reason}", node=name, reason=reason)
        if lacking and lacking == set(self.usable):
            await self._manager.remove_service(self.service)
            raise Unavailable(
                f"no agent of the swarm has joined ({reason}); `provisioning/provision image` builds their image"
            )

    async def _image_source(self, image: str) -> str:
        """Export an image to the registry here; return the reference by which nodes pull it."""
        async with self._exporting:
            return f"{self._registry.address}/{NAME}@{await self._manager.export(image, self._images)}"

    # --- images -------------------------------------------------------------------------------------------------------

    async def distribute(self, tag: str) -> str | None:
        """Have all nodes that lack an image pull it, in the background.

        Returns:
            The image's id on the manager's node, or else the id that most nodes have; None if no node has the image.
        """
        id = await self._manager.image_id(tag)
        if id is None:
            return self.agents.image_id(tag)
        for node in self.usable:
            if self.agents.report(node) is not None and not self.agents.has_image(node, id):
                self._start_pull(node, tag, id)
        return id

    def _start_pull(self, node: str, tag: str, id: str) -> None:
        if (node, id) in self._pulls:
            return
        task = self._pulls[node, id] = asyncio.create_task(self._pull(node, tag, id))
        task.add_done_callback(lambda _: self._pulls.pop((node, id)))

    async def _pull(self, node: str, tag: str, id: str) -> None:
        try:
            source = await self._image_source(id)
            await self.agents.pull_image(node, PullImage(tag, source, USER, self._registry.secret))
            await self.agents.wait_until(lambda: self.agents.has_image(node, id), REPORT_TIMEOUT)
            log.info("node {node} has pulled {tag}", node=self.nodes[node].name, tag=tag)
        except RceError as error:
            log.warn("node {node} did not pull {tag}: {error}", node=self.nodes[node].name, tag=tag, error=str(error))

    async def fit(self, spec: EnvironmentSpec, image: str) -> tuple[str, list[str]]:
        """Choose the nodes that an environment may be placed on; wait for a node that is pulling the image.

        Args:
            spec: The environment.
            image: The image to use if `spec` names none.

        Returns:
            The image's id, and Swarm's placement constraints that admit only nodes with the image and the features.

        Raises:
            StartFailed: No node has the image.
            NoCapacity: No node with the special features has an agent and the image.
        """
        tag = reference(spec.options.image or image)
        id = await self.distribute(tag)
        if id is None:
            raise StartFailed(
                f"environment {spec.name} did not start: no node of the swarm has an image {tag} for RCE "
                f"{__version__}; `provisioning/provision image` builds those of the platform"
            )
        wanted = set(spec.options.specialFeatures) - self.common_features
        able = {node.id for node in self.usable.values() if wanted <= node.features}
        while not any(self.agents.has_image(node, id) for node in able):
            pulls = [task for (node, image_id), task in self._pulls.items() if node in able and image_id == id]
            if not pulls:
                names = ", ".join(sorted(self.nodes[node].name for node in able)) or "none"
                raise NoCapacity(
                    f"environment {spec.name}: none of the nodes with its special features ({names}) has an agent and "
                    f"the image {tag} of the manager's node"
                )
            await asyncio.wait(pulls, return_when=asyncio.FIRST_COMPLETED)
        excluded = [f"node.id!={node}" for node in self.usable if not self.agents.has_image(node, id)]
        return id, excluded + [f"{FEATURE}{feature}==true" for feature in sorted(wanted)]

    async def remove_run(self, node: str, run: str) -> bool:
        """Remove everything of an environment from its node, or from any node if its node has left the swarm.

        Returns:
            True if a container of it was found, or if its node is unusable at present: the node's next agent removes
            it.
        """
        if node not in self.nodes:
            return await self.agents.remove_run_everywhere(run)
        return not self.nodes[node].usable or await self.agents.remove_run(node, run)
