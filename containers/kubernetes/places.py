"""Directories on a node: where the agent opens the sockets of environments, which their pods see read-only."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from containers.endpoint import CONTROL, EndpointPaths
from containers.kubernetes.objects import identity

SOCKETS = "/run/rce-user"  # path in a pod of the sockets of its user's environments on the node
PACKAGES = "/run/rce-packages"  # path in a pod of the users' packages that the agent has fetched


class Places(Struct, frozen=True):
    """Directories of one task set on every node; an environment gets nothing there that it can write to."""

    root: Path

    @staticmethod
    def of(directory: str, task_set: str) -> Places:
        """Return the places of a task set."""
        return Places(Path(directory) / task_set)

    @property
    def runs(self) -> Path:
        """Directory with one for each run of an environment."""
        return self.root / "runs"

    @property
    def users(self) -> Path:
        """Directory with one for each user."""
        return self.root / "users"

    def control(self, run: str) -> Path:
        """Return the directory of the sockets that only one environment sees."""
        return self.runs / run / "control"

    def packages(self, run: str) -> Path:
        """Return the directory of the packages of one environment."""
        return self.runs / run / "packages"

    def hosts(self, run: str) -> Path:
        """Return the hosts file of an environment in a group."""
        return self.runs / run / "hosts"

    def disk(self, run: str) -> Path:
        """Return the file of an environment's disk, which it does not see."""
        return self.runs / run / "disk"

    def record(self, run: str) -> Path:
        """Return the file by which the next agent serves an environment again; the environment does not see it."""
        return self.runs / run / "environment.json"

    def sockets(self, name: str) -> Path:
        """Return the directory of the sockets of all environments of a user on a node; `name` is that of one."""
        return self.users / identity(name.partition("/")[0])

    def socket(self, name: str, run: str) -> Path:
        """Return the socket on which an environment accepts data links."""
        return self.sockets(name) / f"{run}.sock"


def endpoint_paths(run: str) -> EndpointPaths:
    """Return the paths as an environment sees them; see `KubernetesEngine.sockets`."""
    return EndpointPaths(Path(CONTROL), Path(SOCKETS) / f"{run}.sock")
