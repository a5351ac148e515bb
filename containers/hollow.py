"""`python -P -m containers.hollow`: a machine of fake environments, for `rce bench dashboard`.

A real task set with the fake engine. The environment endpoints are control connections of this process.
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

from containers.engine import Ended
from containers.fake import FakeEngine, FakeMachine
from containers.taskset import TaskSet
from rce import loop
from rce.bench.hollow import join
from rce.calls.environments import EnvironmentSpec
from rce.calls.watching import Used
from rce.credential import Credential
from rce.settings import load_or_exit

PROGRAM = "rce bench"


class Settings(Struct, frozen=True):
    """A machine of fake environments."""

    data_dir: Annotated[Path, Meta(description="directory for what the task set keeps")]
    master: Annotated[str, Meta(description="control address of the Master")]
    size: Annotated[int, Meta(ge=1, description="slots for environments")]
    name: Annotated[str, Meta(description="name of this task set")] = "hollow"
    token: Annotated[str, Meta(description="one-time join token")] = ""


class Inhabitant(Protocol):
    """The endpoint of an environment."""

    def close(self) -> None: ...


class HollowEngine(FakeEngine):
    """Fake environments with endpoints, which use more and more."""

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[Ended], None],
        machine: FakeMachine,
        inhabit: Callable[[EnvironmentSpec], Awaitable[Inhabitant]],
    ) -> None:
        super().__init__(capacity, features, ended, machine)
        self._inhabit = inhabit
        self._inhabitants: dict[str, Inhabitant] = {}
        self._began = time.monotonic()

    async def launch(self, spec: EnvironmentSpec) -> None:
        await super().launch(spec)
        self._inhabitants[spec.name] = await self._inhabit(spec)

    async def remove(self, name: str) -> None:
        inhabitant = self._inhabitants.pop(name, None)
        if inhabitant is not None:
            inhabitant.close()
        await super().remove(name)

    async def usage(self) -> dict[str, Used]:
        passed = time.monotonic() - self._began
        return {name: Used(passed**2 / 1000, int(1e8 + 1e6 * passed)) for name in self.machine.running}


async def serve(reactor: ReactorBase, settings: Settings) -> None:
    async def inhabit(spec: EnvironmentSpec) -> Inhabitant:
        return await join(reactor, settings.master, "environment", spec.name, spec.token)

    directory = settings.data_dir.absolute()
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    task_set = TaskSet(
        reactor,
        settings.master,
        settings.name,
        Credential(directory / "container.credential", settings.token),
        lambda ended: HollowEngine(settings.size, (), ended, FakeMachine(), inhabit),
        directory / "packages",
    )
    await task_set.run(stop_environments=False)


def main() -> int:
    settings = load_or_exit(Settings, PROGRAM)
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: serve(reactor, settings))


if __name__ == "__main__":
    sys.exit(main())
