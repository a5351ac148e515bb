"""`python -P -m containers.hollow`: a task set with fake environments, for `rce bench dashboard`.

The task set is real and its engine is the fake one. The environment endpoints are control connections of this process.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Awaitable, Callable, Collection
from pathlib import Path
from typing import Annotated, Protocol

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase

from containers.engine import EnvironmentEnded
from containers.fake import FakeEngine, FakeMachine
from containers.taskset import TaskSet
from rce.bench.hollow import join
from rce.control.calls.environments import EnvironmentSpec
from rce.control.calls.watching import EnvironmentUsage
from rce.control.credential import Credential
from rce.process import loop
from rce.process.settings import load_or_exit

PROGRAM = "rce bench"


class Settings(Struct, frozen=True):
    """Task set with fake environments."""

    data_dir: Annotated[Path, Meta(description="directory for what the task set keeps")]
    master: Annotated[str, Meta(description="control address of the Master")]
    size: Annotated[int, Meta(ge=1, description="slots for environments")]
    name: Annotated[str, Meta(description="name of this task set")] = "hollow"
    token: Annotated[str, Meta(description="one-time join token")] = ""


class EndpointConnection(Protocol):
    """Connection of an environment's endpoint to the Master."""

    def close(self) -> None:
        """Disconnect the endpoint."""


class HollowEngine(FakeEngine):
    """Fake environments that join the Master and whose resource usage grows with time."""

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[EnvironmentEnded], None],
        machine: FakeMachine,
        join: Callable[[EnvironmentSpec], Awaitable[EndpointConnection]],
    ) -> None:
        """Prepare an engine; `join` connects the endpoint of an environment to the Master."""
        super().__init__(capacity, features, ended, machine)
        self._join = join
        self._endpoints: dict[str, EndpointConnection] = {}
        self._began = time.monotonic()

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Add the environment and connect its endpoint."""
        await super().launch(spec)
        self._endpoints[spec.name] = await self._join(spec)

    async def remove(self, name: str) -> None:
        """Disconnect the endpoint and remove the environment."""
        endpoint = self._endpoints.pop(name, None)
        if endpoint is not None:
            endpoint.close()
        await super().remove(name)

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the same growing usage for all environments."""
        passed = time.monotonic() - self._began
        return {name: EnvironmentUsage(passed**2 / 1000, int(1e8 + 1e6 * passed)) for name in self.machine.running}


async def serve(reactor: ReactorBase, settings: Settings) -> None:
    """Run the task set that `settings` describe."""

    async def join_environment(spec: EnvironmentSpec) -> EndpointConnection:
        return await join(reactor, settings.master, "environment", spec.name, spec.token)

    directory = settings.data_dir.absolute()
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    task_set = TaskSet(
        reactor,
        settings.master,
        settings.name,
        Credential(directory / "container.credential", settings.token),
        lambda ended: HollowEngine(settings.size, (), ended, FakeMachine(), join_environment),
        directory / "packages",
    )
    await task_set.run(stop_environments=False)


def main() -> int:
    """Run the program; return its exit status."""
    settings = load_or_exit(Settings, PROGRAM)
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: serve(reactor, settings))


if __name__ == "__main__":
    sys.exit(main())
