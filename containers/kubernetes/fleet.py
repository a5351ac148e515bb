"""Nodes of a cluster and their agents."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path

from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.logger import Logger

from containers.agents.connections import AgentAccess, Agents
from containers.agents.fleet import NodeFleet
from containers.kubernetes.api import Api
from containers.kubernetes.daemonset import agent_daemonset, agent_name, agent_secret
from containers.kubernetes.mirror import Mirror
from containers.kubernetes.objects import AGENT, TASK_SET, Node, Object, read_node
from containers.kubernetes.setup import ClusterSetup
from containers.ports import listen_again
from containers.settings import is_local
from rce.control.connection import Handlers
from rce.errors import InvalidRequest, RceError, Unavailable
from rce.net.tls import Tls

log = Logger()
AGENTS_TIMEOUT = 60.0  # seconds for the agents to join when the engine opens; their image may have to be pulled


class Fleet(NodeFleet[Node]):
    """The nodes of the cluster with their agents.

    `features` are those of every node; a node has more by its labels. The file `file` keeps the secret and the port by
    which agents reach the task set. `changed` is called with each node that has changed or gone.
    """

    def __init__(
        self,
        api: Api,
        cluster: ClusterSetup,
        task_set: str,
        features: Collection[str],
        file: Path,
        changed: Callable[[str], None],
    ) -> None:
        super().__init__(features)
        self._api = api
        self._cluster = cluster
        self._task_set = task_set
        self._file = file
        self._notify = changed
        self._mirror = Mirror(api, "/api/v1/nodes", "", read_node, self._changed, self._gone)

    async def open(
        self,
        reactor: ReactorBase,
        master: str,
        tls: Tls | None,
        reported: Callable[[str], None],
        add_handlers: Callable[[Handlers], None],
    ) -> None:
        """Survey the nodes, run an agent on each, and wait for the agents to join.

        Raises:
            InvalidRequest: `master` is an address of this machine only, so the nodes cannot reach it.
            Unavailable: Kubernetes refuses, the port for the agents cannot be used, or no agent joins.
        """
        if is_local(master):
            raise InvalidRequest(
                f"{master} is not an address at which the nodes of a cluster reach the Master: give one that they can "
                "reach",
                field="master",
            )
        if not self._cluster.agent.address:
            raise InvalidRequest(
                "the engine kubernetes needs agent_address, at which agents reach this task set: the name of its "
                "Service, or an address of this machine",
                field="agent_address",
            )
        await self._mirror.open()
        access = AgentAccess.load(self._file)
        self.agents = Agents(access.secret, reported, add_handlers)
        given = self._cluster.agent.port
        try:
            listen = partial(self._listen, reactor, tls)
            port = await (listen(given) if given else listen_again(listen, access.port))
        except CannotListenError as error:
            raise Unavailable(f"cannot listen for the agents of the cluster: {error}") from None
        AgentAccess(access.secret, port).store(self._file)
        await self._run_agents(master, port, access.secret, tls)
        await self._await_agents()

    async def close(self) -> None:
        """Stop serving the agents, which keep running, and watching the nodes."""
        await self._mirror.close()
        if hasattr(self, "agents"):
            await self.agents.close()

    async def remove_agents(self) -> None:
        """Remove the agents and their secret."""
        name, place = agent_name(self._task_set), f"namespaces/{self._cluster.namespace}"
        await self._api.delete(f"/apis/apps/v1/{place}/daemonsets/{name}")
        await self._api.delete(f"/api/v1/{place}/secrets/{name}")

    async def _listen(self, reactor: ReactorBase, tls: Tls | None, port: int) -> int:
        return await self.agents.listen(reactor, f"tcp:{port}", tls)

    async def _run_agents(self, master: str, port: int, secret: str, tls: Tls | None) -> None:
        settings = {"RCE_MASTER": master, "RCE_TASK_SET": f"tcp:{self._cluster.agent.address}:{port}"}
        name, place = agent_name(self._task_set), f"namespaces/{self._cluster.namespace}"
        await self._api.apply(f"/api/v1/{place}/secrets/{name}", agent_secret(self._cluster, self._task_set, secret))
        directory = tls.directory if tls is not None else None
        daemonset = agent_daemonset(self._cluster, self._task_set, settings, directory)
        await self._api.apply(f"/apis/apps/v1/{place}/daemonsets/{name}", daemonset)

    async def _await_agents(self) -> None:
        """Wait for the agents to join and log which do not.

        Raises:
            Unavailable: No agent joins.
        """
        lacking = await self.agents.wait_for_reports(self.usable, AGENTS_TIMEOUT)
        reasons = await self._agent_failures() if lacking else {}
        for node in lacking:
            reason = reasons.get(node, "Kubernetes has not started one there")
            log.warn("node {node} takes no environments until its agent has joined: {reason}", node=node, reason=reason)
        if lacking and lacking == set(self.usable):
            raise Unavailable(
                f"no agent of the cluster has joined ({'; '.join(reasons.values()) or 'none was started'}): see "
                f"`kubectl describe daemonset {agent_name(self._task_set)} --namespace {self._cluster.namespace}`"
            )

    async def _agent_failures(self) -> Mapping[str, str]:
        """Return what Kubernetes says of agents that do not run, by node."""
        path = f"/api/v1/namespaces/{self._cluster.namespace}/pods"
        try:
            found = await self._api.get(path, labelSelector=f"{TASK_SET}={self._task_set},{AGENT}=yes")
        except RceError as error:
            return {"": str(error)}
        return {each["spec"].get("nodeName", ""): _failure(each) + await self._output(each) for each in found["items"]}

    async def _output(self, pod: Object) -> str:
        """Return the last line of an agent that has ended, with a comma before it."""
        metadata = pod["metadata"]
        path = f"/api/v1/namespaces/{metadata['namespace']}/pods/{metadata['name']}/log"
        try:
            lines = (await self._api.text(path, previous="true", tailLines="3")).splitlines()
        except RceError:  # it has not ended, or not started
            return ""
        return f", {lines[-1]}" if lines else ""

    def _changed(self, node: Node) -> None:
        self.nodes[node.name] = node
        self._notify(node.name)

    def _gone(self, node: Node) -> None:
        self.nodes.pop(node.name, None)
        self._notify(node.name)


def _failure(pod: Object) -> str:
    states = [each.get("state", {}) for each in pod.get("status", {}).get("containerStatuses") or []]
    words = [detail for state in states for detail in state.values() if detail.get("reason")]
    if words:
        return f"{words[0]['reason']}: {words[0].get('message', '')}"
    return f"its pod is {pod.get('status', {}).get('phase', 'unknown')} and the agent does not reach this task set"
