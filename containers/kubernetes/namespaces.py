"""Namespaces of environments with their NetworkPolicy objects and copies of the image pull secrets."""

from __future__ import annotations

from twisted.logger import Logger

from containers.kubernetes.api import Api
from containers.kubernetes.objects import TASK_SET, Object, identity
from containers.kubernetes.policies import group_policy, policies
from containers.kubernetes.setup import ClusterSetup
from rce.control.calls.environments import Group
from rce.errors import NotFound

log = Logger()


class Namespaces:
    """One namespace for all environments of a task set, or one for each user."""

    def __init__(self, api: Api, cluster: ClusterSetup, task_set: str) -> None:
        self._api = api
        self._cluster = cluster
        self._task_set = task_set
        self._prepared: set[str] = set()

    @property
    def pods(self) -> str:
        """Path of the collection with the pods of all environments."""
        return "/api/v1/pods" if self._cluster.per_user else f"/api/v1/namespaces/{self._cluster.namespace}/pods"

    async def prepare(self, namespace: str, group: Group | None) -> None:
        """Create what environments need in a namespace, and in a group.

        Raises:
            Unavailable: Kubernetes does not answer, or refuses.
            NotFound: The namespace does not exist.
        """
        if namespace not in self._prepared:
            if namespace != self._cluster.namespace:
                await self._api.apply(f"/api/v1/namespaces/{namespace}", self._namespace(namespace))
                for name in self._cluster.pull_secrets:
                    await self._copy_secret(name, namespace)
            for policy in policies(namespace, self._task_set):
                await self._apply_policy(policy)
            self._prepared.add(namespace)
        if group is not None:
            await self._apply_policy(group_policy(namespace, self._task_set, identity(group.name)))

    async def _apply_policy(self, policy: Object) -> None:
        metadata = policy["metadata"]
        place = f"/apis/networking.k8s.io/v1/namespaces/{metadata['namespace']}/networkpolicies"
        await self._api.apply(f"{place}/{metadata['name']}", policy)

    async def _copy_secret(self, name: str, namespace: str) -> None:
        try:
            found = await self._api.get(f"/api/v1/namespaces/{self._cluster.namespace}/secrets/{name}")
        except NotFound:  # Kubernetes passes over a missing one too, as an image may need none
            log.warn("{namespace} has no pull secret {name}", namespace=self._cluster.namespace, name=name)
            return
        copy = {
            "apiVersion": "v1",
            "kind": "Secret",
            "metadata": {"name": name, "namespace": namespace, "labels": {TASK_SET: self._task_set}},
            "type": found["type"],
            "data": found.get("data", {}),
        }
        await self._api.apply(f"/api/v1/namespaces/{namespace}/secrets/{name}", copy)

    def _namespace(self, name: str) -> Object:
        # The pods have directories of their node, read-only, which Pod Security Admission knows as `privileged` only.
        labels = {TASK_SET: self._task_set, "pod-security.kubernetes.io/enforce": "privileged"}
        return {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name, "labels": labels}}
