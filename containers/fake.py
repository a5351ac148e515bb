"""Engines without real environments, for tests and scale trials. `FakeEngine` passes the contract suite of engines.

The other engines misbehave as their names say. A `FakeMachine` stands for the state outside of the process: it remains
when an engine is replaced by a new one, as containers remain when the task set is restarted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection

from containers.engine import Engine, EnvironmentEnded, RunningEnvironment
from rce.control.calls.environments import EnvironmentSpec
from rce.control.calls.watching import EnvironmentUsage
from rce.errors import StartFailed, Unavailable


class FakeMachine:
    """Running environments, and runs that are half-started or dead but not removed, by name."""

    def __init__(self) -> None:
        self.running: dict[str, RunningEnvironment] = {}
        self.leftovers: dict[str, str] = {}
        self.watcher: FakeEngine | None = None
        self.used: dict[str, EnvironmentUsage] = {}

    def end(self, name: str, status: int) -> None:
        """End an environment by itself; like a dead container it remains until it is removed."""
        ended = self.running.pop(name)
        self.leftovers[name] = ended.run
        if self.watcher is not None:
            self.watcher.report_end(name, ended.run, f"ended with status {status}", status)


class FakeEngine(Engine):
    """Environments are entries in the dictionaries of a FakeMachine."""

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[EnvironmentEnded], None],
        machine: FakeMachine | None = None,
    ) -> None:
        """Prepare an engine for `machine`, or for a new one."""
        super().__init__(capacity, features, ended)
        self.machine = machine or FakeMachine()

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Add the environment, which is a leftover until the launch has succeeded."""
        self.machine.leftovers[spec.name] = spec.run
        await asyncio.sleep(0)
        del self.machine.leftovers[spec.name]
        self.machine.running[spec.name] = RunningEnvironment(spec.run, spec.options.size)

    async def remove(self, name: str) -> None:
        """Remove the environment; its end is reported, as a real machine reports it whatever the cause."""
        removed = self.machine.running.pop(name, None)
        self.machine.leftovers.pop(name, None)
        if removed is not None:
            self.report_end(name, removed.run, "killed by SIGTERM", -15)
        await asyncio.sleep(0)

    async def recover(self) -> dict[str, RunningEnvironment]:
        """Adopt what runs on the machine and clear its leftovers."""
        self.machine.leftovers.clear()
        self.machine.watcher = self
        return dict(self.machine.running)

    async def last_lines(self, name: str) -> list[str]:
        """Return one line with the name."""
        return [f"last words of {name}"]

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the usage that is set in the machine, or a small one."""
        return {name: self.machine.used.get(name, EnvironmentUsage(0.0, 1)) for name in self.machine.running}

    async def release(self) -> None:
        """Stop watching the machine."""
        self.machine.watcher = None


class SlowEngine(FakeEngine):
    """Starts wait until `go` is set."""

    go: asyncio.Event

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Wait, then add the environment."""
        self.machine.leftovers[spec.name] = spec.run
        await self.go.wait()
        await super().launch(spec)

    async def recover(self) -> dict[str, RunningEnvironment]:
        """Create the event in the running event loop, then recover."""
        self.go = asyncio.Event()
        return await super().recover()


class NeverEngine(FakeEngine):
    """Starts never finish."""

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Wait until cancelled."""
        self.machine.leftovers[spec.name] = spec.run
        await asyncio.get_running_loop().create_future()


class FailingEngine(FakeEngine):
    """Starts fail."""

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Fail as an engine does whose image is missing."""
        self.machine.leftovers[spec.name] = spec.run
        raise StartFailed(f"environment {spec.name}: no such image", lines=["pull access denied"])


class DyingEngine(FakeEngine):
    """Environments end as soon as they run."""

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Add the environment and end it."""
        await super().launch(spec)
        self.machine.end(spec.name, 1)


class UnavailableEngine(FakeEngine):
    """While `unavailable` is set, the machine does not answer and launches remain half-done."""

    unavailable = False

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Leave a half-started environment if the machine is unavailable."""
        self.machine.leftovers[spec.name] = spec.run
        self._check_available()
        await super().launch(spec)

    async def remove(self, name: str) -> None:
        """Remove the environment if the machine is available."""
        self._check_available()
        await super().remove(name)

    def _check_available(self) -> None:
        if self.unavailable:
            raise Unavailable("the machine does not answer")
