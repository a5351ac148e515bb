"""World of the engine `process`: its processes and directories."""

import asyncio
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from containers.engine import Engine, EnvironmentEnded
from containers.process import tree as processes
from containers.process.domains import Domains
from containers.process.engine import ProcessEngine
from tests.support.containers.engine_contract import CAPACITY, FEATURES, World
from tests.support.domains import domain
from tests.support.paths import TESTS

STAND_IN = (sys.executable, "-I", "-S", str(TESTS / "support" / "containers" / "stand_in.py"))


async def until(condition: Callable[[], bool]) -> None:
    """Wait until another process has made a condition true."""
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110  # the other process cannot notify this one
            await asyncio.sleep(0.002)


class ProcessWorld(World):
    def __init__(self, directory: Path) -> None:
        self.root = directory / "environments"
        # This process holds them on the machine: an engine removes the ports of its domains from shared memory.
        self.domains = Domains(directory / "domains", [domain(f"environment {number}") for number in range(8)])

    def engine(self, ended: Callable[[EnvironmentEnded], None], *behaviour: str) -> ProcessEngine:
        return ProcessEngine(
            CAPACITY,
            FEATURES,
            ended,
            root=self.root,
            packages=self.root.parent / "packages",
            settings={"master": "tcp:127.0.0.1:1", "typesupport": "/types"},
            command=[*STAND_IN, *behaviour],
            domains=self.domains,
        )

    def break_start(self, engine: Engine) -> None:
        assert isinstance(engine, ProcessEngine)
        engine._command = ["/nonexistent/program"]

    async def seen(self, name: str) -> dict[str, Any]:
        """Return what the stand-in wrote to `seen.json`, once it has started."""
        await until(lambda: any(self.root.joinpath(name).glob("*/seen.json")))
        (file,) = self.root.joinpath(name).glob("*/seen.json")
        return dict(json.loads(file.read_text()))

    async def end(self, name: str) -> None:
        await self.seen(name)
        run = self.alive()[name]
        (pid,) = [pid for pid, environ in self._processes() if environ["RCE_RUN"] == run]
        os.kill(pid, signal.SIGUSR1)
        await until(lambda: run not in self.alive().values())

    def remains(self) -> set[str]:
        """Return the names of environments; an empty directory of a user counts under the user's name."""
        tags = {str(path.relative_to(self.root)) for path in self.root.glob("*/*")}
        users = {path.name for path in self.root.glob("*")}
        return tags | (users - {tag.partition("/")[0] for tag in tags}) | set(self.alive())

    def alive(self) -> dict[str, str]:
        return {environ["RCE_NAME"]: environ["RCE_RUN"] for _, environ in self._processes()}

    def _processes(self) -> list[tuple[int, dict[str, str]]]:
        found = []
        for pid in [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]:
            environ = dict(line.decode().split("=", 1) for line in processes.environ(pid) if b"=" in line)
            if environ.get("RCE_DATA_DIR", "").startswith(str(self.root)):
                found.append((pid, environ))
        return found
