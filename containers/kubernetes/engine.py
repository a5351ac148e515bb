"""The engine `kubernetes`: each environment is a pod, which Kubernetes places on one of many nodes.

Kubernetes never restarts the pod: a restarted environment has a new run and a new token, so it is a new pod. The engine
watches its pods and the nodes, so it knows of starts, ends, drained and lost nodes without asking. It runs an agent on
every node (agent.py), which confines a pod from outside and serves its sockets.

Everything that an engine must know after a restart is in the labels and annotations of the pods.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Coroutine, Sequence
from dataclasses import dataclass

from twisted.logger import Logger

from containers.agents.fleet import FleetEngine
from containers.agents.placements import Placement
from containers.data_relay import GATE
from containers.docker.disks import check_size
from containers.docker.setup import Setup
from containers.endpoint import CONTROL, reference
from containers.engine import LAST_LINES, EnvironmentEnded, RunningEnvironment
from containers.kubernetes.api import Api, Refused
from containers.kubernetes.fleet import Fleet
from containers.kubernetes.groups import Groups
from containers.kubernetes.mirror import Mirror
from containers.kubernetes.namespaces import Namespaces
from containers.kubernetes.objects import (
    ENVIRONMENT,
    RUN,
    TASK_SET,
    Pod,
    PodState,
    identity,
    read_pod,
    read_pod_state,
    task_set_id,
)
from containers.kubernetes.places import SOCKETS
from containers.kubernetes.pod import PodSetup, environment_pod
from containers.kubernetes.setup import ClusterSetup
from containers.limits import limits
from containers.logfile import LONGEST_LINE
from rce.control.calls.agents import ConnectGroup, Furnish
from rce.control.calls.environments import EnvironmentSpec, FetchPackage
from rce.control.calls.watching import EnvironmentUsage
from rce.control.connection import Handlers
from rce.errors import Lost, NoCapacity, NotFound, RceError, StartFailed, TimedOut
from rce.process.metrics import Family

log = Logger()
START_TIMEOUT = 150.0  # seconds for a pod to run and to be furnished; its image may have to be pulled
END_TIMEOUT = 60.0  # seconds for a deleted pod to be gone
PATIENCE = 5.0  # seconds for a pod that no node takes: another pod may be ending
LATEST_END = 5.0  # seconds until Kubernetes knows of an end that an agent has noticed
LOG_BYTES = 256 * 1024


@dataclass
class _Placement(Placement):
    """Placement in a pod, None until Kubernetes has reported it."""

    pod: Pod | None = None
    furnishing: bool = False


class KubernetesEngine(FleetEngine):
    """Runs environments as pods of the cluster that this process runs in, or else that of KUBECONFIG.

    `features` are those of every node; a node has more by its labels (`rce.feature/NAME: "true"`). With `keep_agents`
    the agents keep running when the engine is closed.
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
        cluster: ClusterSetup,
        keep_agents: bool = True,
    ) -> None:
        """Prepare the engine; arguments are as in `containers.settings.Settings`."""
        super().__init__(capacity, features, ended)
        self._setup = setup
        self._cluster = cluster
        self._keep_agents = keep_agents
        self._task_set = task_set_id(setup.labels)
        self._api = Api()
        file = setup.directory / "kubernetes.json"
        self._fleet = Fleet(self._api, cluster, self._task_set, features, file, self._node_changed)
        self._namespaces = Namespaces(self._api, cluster, self._task_set)
        self._groups = Groups(self._group_members, self._call_agent)
        pods, selector = self._namespaces.pods, self._selector(RUN)
        self._pods = Mirror(self._api, pods, selector, read_pod, self._pod_changed, self._pod_gone)
        self._placements: dict[str, _Placement] = {}  # by name
        self._background: set[asyncio.Task[None]] = set()
        self._adopted = False
        self._closed = False

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Create the pod and wait until an agent serves its environment."""
        if spec.options.disk:
            check_size(spec.options.disk)
        granted = limits(spec, [], self._fleet.largest)
        wanted = set(spec.options.specialFeatures) - self._fleet.common_features
        image = reference(spec.options.image or self._setup.image)
        pod = environment_pod(self._pod_setup(), spec, granted, image, wanted)
        namespace = pod["metadata"]["namespace"]
        placement = self._placements[spec.name] = _Placement(spec.run)
        await self._namespaces.prepare(namespace, spec.group)
        try:
            await self._api.create(f"/api/v1/namespaces/{namespace}/pods", pod)
        except (Refused, NotFound) as error:
            raise StartFailed(f"environment {spec.name} did not start: {error}") from None
        try:
            async with asyncio.timeout(START_TIMEOUT):
                await placement.settled
        except TimeoutError:
            raise StartFailed(
                f"environment {spec.name} did not start: no node has run it within {START_TIMEOUT:g} s"
            ) from None

    async def remove(self, name: str) -> None:
        """Delete all pods of an environment and wait until they are gone; remove what they left on nodes.

        A closed engine manages no environments, so it removes none.
        """
        if self._closed:
            return
        found = await self._find_pods(f"{ENVIRONMENT}={identity(name)}")
        await asyncio.gather(*map(self._remove_pod, found))
        self._placements.pop(name, None)

    async def recover(self) -> dict[str, RunningEnvironment]:
        """Start the agents, adopt running pods and remove the rest.

        Raises:
            Unavailable: There is no cluster, it refuses, or no agent joins.
            InvalidRequest: The nodes cannot reach the Master or this task set.
        """
        await self._api.open()
        await self._namespaces.prepare(self._cluster.namespace, None)
        await self._fleet.open(
            self._setup.reactor, self._setup.master, self._setup.tls, self._reported, self._add_handlers
        )
        self._node_changed("")
        await self._pods.open()
        adopted: dict[str, RunningEnvironment] = {}
        for found in await self._find_pods(RUN):
            pod = self._pods.objects.get(found.uid)  # None if its annotation is malformed
            if pod is not None and pod.running and not pod.deleted and pod.node in self._fleet.usable:
                placement = self._placements[pod.spec.name] = _Placement(pod.run, pod)
                placement.settle()
                adopted[pod.spec.name] = RunningEnvironment(pod.run, pod.spec.options.size)
            else:
                log.info("removing the remains of {name}", name=pod.spec.name if pod is not None else found.name)
                await self._remove_pod(found)
        self._adopted = True
        for node in self._fleet.usable:
            self._reported(node)
        return adopted

    async def last_lines(self, name: str) -> list[str]:
        """Return the last lines of output; none if the node is lost."""
        placement = self._placements.get(name)
        if placement is None or placement.pod is None or placement.pod.node not in self._fleet.usable:
            return []
        try:
            query = {"tailLines": str(LAST_LINES), "limitBytes": str(LOG_BYTES)}
            text = await self._api.text(f"{placement.pod.path}/log", **query)
        except RceError as error:  # the pod was deleted by another
            log.info("the output of {name} cannot be read: {error}", name=name, error=str(error))
            return []
        return [line[:LONGEST_LINE] for line in text.splitlines()]

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the resources that environments have used on all nodes."""
        found = await self._fleet.agents.usage()
        return {name: found[name] for name in self.running() if name in found}

    async def metrics(self) -> dict[str, list[Family]]:
        """Return the metrics of the agents by node."""
        return await self._fleet.agents.metrics()

    async def release(self) -> None:
        """Disconnect from the cluster and the agents; remove the agents too if they are not to be kept."""
        self._closed = True
        await self._pods.close()
        for task in self._background:
            task.cancel()
        await asyncio.gather(*self._background, return_exceptions=True)
        if not self._keep_agents and not self._placements and hasattr(self._fleet, "agents"):
            await self._fleet.remove_agents()
        await self._fleet.close()
        await self._api.close()
        self._placements.clear()

    def _pod_setup(self) -> PodSetup:
        settings = {**self._setup.settings, "relay": f"{CONTROL}/{GATE}"}
        return PodSetup(self._task_set, self._cluster, self._setup.command, settings, self._setup.read_only)

    def _selector(self, labels: str) -> str:
        """Return a selector of this task set's objects that match another selector too."""
        return f"{TASK_SET}={self._task_set},{labels}"

    # --- removal ------------------------------------------------------------------------------------------------------

    async def _find_pods(self, labels: str) -> list[PodState]:
        """Return the pods of this task set that match a selector."""
        found = await self._api.get(self._namespaces.pods, labelSelector=self._selector(labels))
        return [read_pod_state(each) for each in found["items"]]

    async def _remove_pod(self, pod: PodState) -> None:
        """Delete a pod and wait until it is gone; on a lost node only its object, as nobody there answers.

        When the node returns, its kubelet ends a container without an object.
        """
        lost = pod.node != "" and pod.node not in self._fleet.usable
        with self._pods.changes() as change:
            try:
                async with asyncio.timeout(END_TIMEOUT):
                    await self._api.delete(pod.path, 0 if lost or pod.never_ran else None, pod.uid)
                    while await self._exists(pod):
                        change.clear()
                        known = self._pods.objects.get(pod.uid)
                        if known is not None and known.end is not None:
                            await self._api.delete(pod.path, 0, pod.uid)  # old kubelets let the object stay for 10 s
                        elif known is not None:
                            await change.wait()
                        else:  # the watch is behind, or has not begun
                            await asyncio.sleep(0.1)
            except TimeoutError:
                raise TimedOut(f"the pod {pod.name} has not ended within {END_TIMEOUT:g} s") from None
        if pod.node and not lost:
            await self._fleet.agents.remove_run(pod.node, pod.run)

    async def _exists(self, pod: PodState) -> bool:
        try:
            found = await self._api.get(pod.path)
        except NotFound:
            return False
        return bool(found["metadata"]["uid"] == pod.uid)

    # --- what Kubernetes reports --------------------------------------------------------------------------------------

    def _placement(self, pod: Pod) -> _Placement | None:
        placement = self._placements.get(pod.spec.name)
        return placement if placement is not None and placement.run == pod.run else None

    def _pod_changed(self, pod: Pod) -> None:
        placement = self._placement(pod)
        if placement is None:
            if self._adopted and not pod.deleted:
                self.report_stray(pod.spec.name)
            return
        before, placement.pod = placement.pod, pod
        if pod.end is not None and not pod.obstacle:
            self._end(placement, pod)
        elif pod.obstacle:
            self._fail(placement, StartFailed(f"environment {pod.spec.name} did not start: {pod.obstacle}"))
        elif pod.unschedulable and not pod.node and (before is None or not before.unschedulable):
            asyncio.get_running_loop().call_later(PATIENCE, self._give_up, pod.spec.name, placement)
        elif pod.running:
            self._furnish_later(placement)

    def _pod_gone(self, pod: Pod) -> None:
        self._update_group(pod)
        placement = self._placement(pod)
        if placement is not None and placement.pod is not None and placement.pod.uid == pod.uid:
            reason = f"its pod was deleted on node {pod.node}, as when a node is drained"
            if not placement.settle(StartFailed(f"environment {pod.spec.name} did not start: {reason}")):
                self.report_end(pod.spec.name, pod.run, reason, None)

    def _end(self, placement: _Placement, pod: Pod) -> None:
        assert pod.end is not None
        placement.settle()  # it ran, if only for a moment
        reason = pod.end.reason
        if pod.deleted:
            reason += f"; its pod was deleted on node {pod.node}, as when a node is drained"
        self.report_end(pod.spec.name, pod.run, reason, pod.end.status)

    def _fail(self, placement: _Placement, error: RceError) -> None:
        if not placement.settle(error) and placement.pod is not None:
            spec = placement.pod.spec
            self.report_end(spec.name, spec.run, str(error), None)

    def _give_up(self, name: str, placement: _Placement) -> None:
        pod = placement.pod
        if self._placements.get(name) is placement and pod is not None and pod.unschedulable and not pod.node:
            placement.settle(NoCapacity(f"environment {name} cannot be placed: {pod.unschedulable}"))

    def _node_changed(self, name: str) -> None:
        """Take over what the nodes have; report the ends of all environments on a node that is lost."""
        self.features = self._fleet.features
        self.gpus = self._fleet.gpus
        node = self._fleet.nodes.get(name)
        if not name or (node is not None and node.usable):
            return
        reason = node.unusable_reason if node is not None else f"node {name} has left the cluster"
        for placement in list(self._placements.values()):
            if placement.pod is not None and placement.pod.node == name:
                self._fail(placement, StartFailed(reason))

    # --- agents -------------------------------------------------------------------------------------------------------

    def _add_handlers(self, handlers: Handlers) -> None:
        handlers.on(FetchPackage, lambda call: self.request_ticket(call.digest))

    async def _call_agent(self, node: str, call: ConnectGroup) -> None:
        await self._fleet.agents.call(node, call)

    def _reported(self, node: str) -> None:
        """Have an agent that has joined serve what runs on its node, and remove what no longer does."""
        report = self._fleet.agents.report(node)
        if report is None or not self._adopted:
            return
        self.on_relays()
        for placement in self._placements.values():
            if placement.pod is not None and placement.pod.node == node and placement.pod.running:
                if placement.run in report.runs:
                    placement.settle()
                    self._update_group(placement.pod)
                else:
                    placement.furnishing = False
                    self._furnish_later(placement)
        present = {each.run for each in self._pods.objects.values()}
        for run in set(report.runs) - present:
            self._spawn_background(self._remove_run(node, run))

    async def _remove_run(self, node: str, run: str) -> None:
        await self._fleet.agents.remove_run(node, run)

    def _furnish_later(self, placement: _Placement) -> None:
        if not placement.furnishing:
            placement.furnishing = True
            self._spawn_background(self._furnish(placement))

    async def _furnish(self, placement: _Placement) -> None:
        """Have the agent of its node confine and serve a pod that runs; connect its group."""
        pod = placement.pod
        assert pod is not None
        try:
            await self._fleet.agents.call(pod.node, Furnish(pod.spec, pod.container, pod.memory))
        except Lost:
            placement.furnishing = False  # again when an agent of the node has joined
            return
        except RceError as error:
            with self._pods.changes() as change:
                try:
                    async with asyncio.timeout(LATEST_END):
                        while placement.pod is not None and placement.pod.end is None:
                            change.clear()
                            await change.wait()
                    return  # it has ended, which is the reason
                except TimeoutError:
                    self._fail(placement, error)
                    return
        if pod.spec.group is not None:
            await self._groups.update(pod.spec.group.name)
        placement.settle()

    def _group_members(self, group: str) -> Sequence[Pod]:
        """Return the running pods of a group."""
        pods = self._pods.objects.values()
        return [each for each in pods if each.spec.group is not None and each.spec.group.name == group and each.running]

    def _update_group(self, pod: Pod) -> None:
        if pod.spec.group is not None:
            self._spawn_background(self._groups.update(pod.spec.group.name))

    def _spawn_background(self, work: Coroutine[object, object, None]) -> None:
        task = asyncio.ensure_future(work)
        self._background.add(task)
        task.add_done_callback(self._background.discard)
        task.add_done_callback(_log_failure)


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()):
        log.error("a request to the cluster failed: {error}", error=str(error))
