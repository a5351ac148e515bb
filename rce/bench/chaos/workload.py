"""Commands of robots at random, each of which is repeated until it is certain that it was executed."""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from rce.api.map_jobs import Upload
from rce.bench.chaos.flows import NODE, PACKAGE, STRING
from rce.bench.chaos.history import History
from rce.bench.chaos.model import Fact, Model, Step, connection
from rce.bench.chaos.violations import Violation
from rce.client import Robot
from rce.errors import AlreadyExists, NoCapacity, NotFound, RceError, StartFailed, TimedOut, Unavailable

PAUSE = 0.05, 0.35  # seconds between two commands of a robot
RETRY_INTERVAL = 0.3  # seconds after which a command that failed is repeated
DEADLINE = 300.0  # seconds for a command with all its repetitions
UPLOAD_PAUSE = 0.5, 3.0
MAX_UPLOADS = 10
WEIGHTS = {"parameter": 40, "interface": 35, "connection": 25, "node": 2, "environment": 1}
FAULTS = (Unavailable, TimedOut, StartFailed, NoCapacity)  # errors of the platform, not of the command
DISK_FULL = "disk full"
MANY = 4  # things of one kind in one place


class Maps(Protocol):
    """The part of `MapServiceClient` that is used."""

    def upload(self, path: Path) -> Upload:
        """Upload a file."""

    def uploads(self) -> list[Upload]:
        """Return all uploads."""

    def remove_upload(self, upload: str) -> None:
        """Remove an upload."""


class Worker:
    """Executes steps one after the other, and pauses on demand.

    Attributes:
        refused: Number of refusals, by the kind of error; those for a full disk by themselves.
    """

    def __init__(self, name: str, model: Model, history: History) -> None:
        """Prepare a worker; `run` runs it."""
        self.refused: Counter[str] = Counter()
        self._name = name
        self._model = model
        self._history = history
        self._going = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()

    async def run(self) -> None:
        """Execute steps until cancelled.

        Raises:
            Violation: A step cannot be executed, or was executed although it was refused.
        """
        while True:
            await self._going.wait()
            self._idle.clear()
            step = self.choose()
            if step is not None:
                await self.take(step)
            self._idle.set()
            await asyncio.sleep(self.pause())

    def resume(self) -> None:
        """Begin, or go on."""
        self._going.set()

    async def stop(self) -> None:
        """Let the step under way end, and begin none."""
        self._going.clear()
        await self._idle.wait()

    def choose(self) -> Step | None:
        """Return the next step, or None if there is none at present."""
        raise NotImplementedError

    def pause(self) -> float:
        """Return the seconds until the next step."""
        raise NotImplementedError

    async def execute(self, step: Step) -> None:
        """Execute a step once."""
        raise NotImplementedError

    async def take(self, step: Step) -> None:
        """Execute a step, again and again until it is acknowledged.

        Raises:
            Violation: It fails for a reason that faults do not explain, or for longer than DEADLINE. So does one that
                adds something and was refused because a disk was full, but executed.
        """
        executed_already = AlreadyExists if step.verb == "add" else NotFound
        uncertain = False
        until = time.monotonic() + DEADLINE
        while True:
            try:
                await self.execute(step)
                break
            except RceError as error:
                if isinstance(error, executed_already) and uncertain:
                    break
                full = DISK_FULL in str(error)
                if not full and not isinstance(error, FAULTS):
                    raise Violation(f"{self._name} {step}: {type(error).__name__}: {error}") from None
                self._refused(step, error)
                uncertain = uncertain or not full or step.verb == "remove"  # a removal is executed, but not stored
                if time.monotonic() > until:
                    raise Violation(f"{self._name} {step} fails for {DEADLINE:g} s: {error}") from None
            await asyncio.sleep(RETRY_INTERVAL)
        self._model.acknowledge(step)
        self._history.add(self._name, step, "acknowledged")

    def _refused(self, step: Step, error: RceError) -> None:
        full = DISK_FULL in str(error)
        self.refused[DISK_FULL if full else error.info.code] += 1
        self._history.add(self._name, step, f"{error.info.code}: {error}"[:300])


class RobotWorker(Worker):
    """Random commands of a robot, in environments whose names begin with its own."""

    def __init__(self, robot: Robot, model: Model, history: History, seed: int) -> None:
        """Prepare the worker of a robot."""
        super().__init__(robot.name, model, history)
        self._robot = robot
        self._random = random.Random(f"{seed} {robot.name}")
        self._number = 0

    def pause(self) -> float:
        """Return a random time."""
        return self._random.uniform(*PAUSE)

    def choose(self) -> Step | None:
        """Add or remove something of a random kind: add what is not there, remove what is."""
        kind = self._random.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
        fact = self._fact(kind)
        if fact is None:
            return None
        present = fact in self._model.facts
        if kind == "parameter" and self._random.random() < 0.7:
            self._number += 1
            return Step("add", (*fact[:3], str(self._number)))
        if kind == "parameter":
            found = self._model.of_kind("parameter", *fact[1:3])
            return Step("remove", found[0]) if found else None
        return Step("remove" if present else "add", fact)

    def _fact(self, kind: str) -> Fact | None:
        """Return something of a kind that exists or could exist."""
        name, number = self._robot.name, self._random.randrange(MANY)
        homes = [each[1] for each in self._model.of_kind("environment") if each[1].startswith(f"{name}_")]
        home = self._random.choice(homes)
        if kind == "environment":
            return ("environment", f"{name}_more")
        if kind == "node":
            return ("node", home, "more")  # only one, since each costs a second of processor time after each fault
        if kind == "parameter":
            return ("parameter", home, f"parameter{number}")
        if kind == "interface":
            return ("interface", self._random.choice((name, home)), f"chaos{number}")
        ends = [("interface", owner, f"chaos{number}") for owner in (name, home)]
        return connection(*("/".join(each[1:]) for each in ends)) if self._model.facts.issuperset(ends) else None

    async def execute(self, step: Step) -> None:
        """Send the command and wait for its acknowledgement."""
        robot, (kind, *words) = self._robot, step.fact
        adding = step.verb == "add"
        match kind:
            case "environment":
                await (robot.create_environment if adding else robot.destroy_environment)(*words)
            case "node" if adding:
                await robot.add_node(words[0], words[1], PACKAGE, NODE, namespace=words[1])
            case "node":
                await robot.remove_node(*words)
            case "parameter" if adding:
                await robot.set_parameter(*words)
            case "parameter":
                await robot.delete_parameter(*words[:2])
            case "interface" if adding:
                await self._add_interface(*words)
            case "interface":
                await robot.remove_interface(*words)
            case _:
                await (robot.connect if adding else robot.disconnect)(*words)

    async def _add_interface(self, owner: str, tag: str) -> None:
        if owner == self._robot.name:
            await self._robot.add_interface(owner, tag, "SubscriberConverter", STRING)
        else:
            await self._robot.add_interface(owner, tag, "PublisherInterface", STRING, addr=f"/{tag}")


class UploadWorker(Worker):
    """Random uploads to the map service and their removal."""

    def __init__(self, maps: Maps, directory: Path, model: Model, history: History, seed: int) -> None:
        """Prepare the worker; the recordings are made in a directory."""
        super().__init__("uploads", model, history)
        self._maps = maps
        self._directory = directory
        self._random = random.Random(f"{seed} uploads")
        self._number = 0

    def pause(self) -> float:
        """Return a random time."""
        return self._random.uniform(*UPLOAD_PAUSE)

    def choose(self) -> Step | None:
        """Upload a new recording, or remove an old one if there are many."""
        present = self._model.of_kind("upload")
        if len(present) >= MAX_UPLOADS or (present and self._random.random() < 0.3):
            return Step("remove", self._random.choice(present))
        self._number += 1
        return Step("add", ("upload", f"recording{self._number}.log"))

    async def execute(self, step: Step) -> None:
        """Upload or remove a recording."""
        work: Callable[[str], None] = self._add if step.verb == "add" else self._remove
        await asyncio.to_thread(work, step.fact[1])

    def _add(self, name: str) -> None:
        file = self._directory / name
        if not file.exists():
            file.write_text(recording(self._random.randrange(10, 400)))
        self._maps.upload(file)
        file.unlink()

    def _remove(self, name: str) -> None:
        for upload in self._maps.uploads():
            if upload.name == name:
                self._maps.remove_upload(upload.id)
                return
        raise NotFound(f"there is no upload {name}")


def recording(scans: int) -> str:
    """Return a CARMEN log of a robot that stands in the middle of a round room."""
    ranges = " ".join(["4.00"] * 180)
    pose = "0.0 0.0 0.0"
    return "".join(f"FLASER 180 {ranges} {pose} {pose} {at / 10:.1f} chaos {at / 10:.1f}\n" for at in range(scans))
