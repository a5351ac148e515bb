"""The engine `docker`: an environment is a container of its own, without a network, on this machine's Docker.

What it needs of the outside comes through two directories: in one is the socket that leads to the Master (relay.py), in
the other, which the environments of one user share, are the sockets at which their endpoints take data links. So
nothing that an environment sends can reach another user's environments, the host or the network.

Labels on the containers say whose they are; by them they are adopted after a restart of the task set. Docker's event
stream tells of their ends, and nothing is polled.
"""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Callable, Collection, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from twisted.logger import Logger

from containers import docker_disks, shaping
from containers.data_relay import GATE, DataRelay
from containers.docker_daemon import RUN, Daemon, Found, describe
from containers.docker_events import Event
from containers.docker_networks import Networks
from containers.docker_options import CONTROL, Machine, Places, owner, reference, variables, walls
from containers.docker_setup import Setup
from containers.engine import LAST_LINES, Ended, Engine, Life
from containers.limits import Size, limits
from containers.logfile import LONGEST_LINE
from containers.packages import package_path, places
from containers.relay import Relay
from containers.settings import EGRESS_POOL, NAMESERVERS
from rce.calls.environments import EnvironmentSpec
from rce.calls.watching import Used
from rce.errors import NoCapacity, StartFailed, Unavailable
from rce.host import host_identity

log = Logger()


@dataclass
class _Environment:
    """What this process holds for an environment; all else Docker knows."""

    run: str
    places: Places
    relay: Relay
    gpus: Sequence[str]


class DockerEngine(Engine):
    """Environments as containers. The task set must be the only one with its directory."""

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[Ended], None],
        setup: Setup,
        *,
        gpus: int = 0,
        relay: DataRelay | None = None,
        host: str = "",
        egress_pool: str = EGRESS_POOL,
        nameservers: Sequence[str] = NAMESERVERS,
    ) -> None:
        super().__init__(capacity, features, ended)
        self.gpus = gpus
        self._setup = setup
        self._root = setup.directory / "environments"
        self._sockets = setup.directory / "sockets"
        self._packages = setup.directory / "packages"
        self._settings = {**setup.settings, "relay": f"{CONTROL}/{GATE}"}
        self._data_relay = relay or DataRelay()
        self._host = host or host_identity()
        self._daemon = Daemon(setup.labels)
        self._networks = Networks(self._daemon.ask, setup.labels, egress_pool, nameservers)
        self._environments: dict[str, _Environment] = {}
        self._looking: set[asyncio.Task[None]] = set()
        self._following = asyncio.Event()
        self._machine = Machine()

    async def launch(self, spec: EnvironmentSpec) -> None:
        gpus = self._free_gpus(spec)
        granted = limits(spec, gpus, Size.here())
        if spec.options.disk:
            docker_disks.check(spec.options.disk)
        if spec.options.bandwidth and (spec.group is not None or spec.egress != "none"):
            shaping.check()
        packages = places(self._packages, spec.packages)
        with_packages = package_path(packages, self._settings)
        read_only = [*self._setup.read_only, *packages]
        try:
            environment = await self._furnish(spec.name, spec.run, gpus)
            networks = await self._networks.join(spec)
            disk = await self._disk(spec)
            try:
                await self._daemon.start(
                    Found("", spec.name, spec.run, spec.options.size, running=False, gpus=gpus),
                    reference(spec.options.image) if spec.options.image else self._setup.image,
                    self._setup.command,
                    variables(spec, environment.places, self._host, self._settings | with_packages),
                    walls(granted, environment.places, read_only, networks, disk, self._machine),
                )
                await self._shape(spec, len(networks.networks))
            finally:
                if disk is not None:  # it stays as long as it is mounted
                    await asyncio.to_thread(docker_disks.let_go, disk)
        except (OSError, Unavailable) as error:
            raise StartFailed(f"environment {spec.name} did not start: {error}") from None

    def _free_gpus(self, spec: EnvironmentSpec) -> list[str]:
        """Each is one environment's at a time. NoCapacity with the numbers."""
        used = {gpu for environment in self._environments.values() for gpu in environment.gpus}
        free = [str(number) for number in range(self.gpus) if str(number) not in used]
        if spec.options.gpus > len(free):
            raise NoCapacity(
                f"environment {spec.name} needs {spec.options.gpus} GPUs; {len(free)} of this machine's {self.gpus} "
                "are free",
                asked=spec.options.gpus,
                free=len(free),
            )
        return free[: spec.options.gpus]

    async def _shape(self, spec: EnvironmentSpec, networks: int) -> None:
        """What goes over data links is held to the bandwidth by those who take it."""
        if spec.options.bandwidth and networks:
            process = await self._daemon.process(spec.run)
            devices = [f"eth{number}" for number in range(networks)]
            await asyncio.to_thread(shaping.shape, process, devices, spec.options.bandwidth)

    async def _disk(self, spec: EnvironmentSpec) -> docker_disks.Disk | None:
        if not spec.options.disk:
            return None
        file = self._root / spec.name / f"{spec.run}.disk"
        return await asyncio.to_thread(docker_disks.make, file, spec.options.disk, owner())

    async def remove(self, name: str) -> None:
        self._data_relay.dismiss(name)
        await self._daemon.remove(name)
        await self._networks.leave(name)
        environment = self._environments.get(name)
        if environment is not None:
            environment.relay.close()
            environment.places.socket.unlink(missing_ok=True)
        if (self._root / name).is_dir():
            await asyncio.to_thread(shutil.rmtree, self._root / name)
        self._environments.pop(name, None)
        self._sweep(name.partition("/")[0])

    async def recover(self) -> dict[str, Life]:
        """Raises Unavailable when there is no Docker."""
        for directory in (self._root, self._sockets):
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        await self._daemon.connect(self._happened, self._taken_up)
        self._machine = await self._daemon.machine()
        await self._following.wait()  # before the list is made, so that no end is missed
        lives: dict[str, Life] = {}
        for found in await self._daemon.present():
            if found.running and self._places(found.name, found.run).control.is_dir():
                await self._furnish(found.name, found.run, found.gpus)
                lives[found.name] = Life(found.run, found.size)
            else:
                log.info("removing what is left of {name}", name=found.name)
                await self._daemon.remove(found.name)
        await self._networks.recover()
        await self._remove_leftovers()
        return lives

    async def last_lines(self, name: str) -> list[str]:
        lines = await self._daemon.last_lines(self._environments[name].run, LAST_LINES)
        return [line[:LONGEST_LINE] for line in lines]

    async def usage(self) -> dict[str, Used]:
        return await self._daemon.usage()

    async def release(self) -> None:
        self._daemon.close()
        for task in self._looking:
            task.cancel()
        for environment in self._environments.values():
            environment.relay.close()
        for name in self._environments:
            self._data_relay.dismiss(name)
        self._environments.clear()

    # --- places on the host -------------------------------------------------------------------------------------------

    def _places(self, name: str, run: str) -> Places:
        return Places(self._root / name / run, self._sockets / name.partition("/")[0] / f"{run}.sock")

    async def _furnish(self, name: str, run: str, gpus: Sequence[str]) -> _Environment:
        """Make the directories of an environment, unless they are there, and open its way to the Master."""
        places = self._places(name, run)
        environment = _Environment(run, places, Relay(self._setup.reactor, self._setup.master, self._setup.tls), gpus)
        self._environments[name] = environment  # from now on nobody sweeps the directory of its user
        places.control.mkdir(parents=True, exist_ok=True)
        sockets = places.socket.parent
        if not sockets.is_dir():
            sockets.mkdir(mode=0o700)
            if os.geteuid() == 0:
                os.chown(sockets, owner(), owner())
        await environment.relay.open(places.control)
        await self._data_relay.admit(name, places.socket, places.control)
        return environment

    async def _remove_leftovers(self) -> None:
        """Directories, sockets and disks of environments that are no more."""
        await asyncio.to_thread(docker_disks.sweep, self._root)
        for path in [tag for user in _directories(self._root) for tag in _directories(user)]:
            if str(path.relative_to(self._root)) not in self._environments:
                await asyncio.to_thread(shutil.rmtree, path)
        known = {environment.places.socket for environment in self._environments.values()}
        for path in self._sockets.glob("*/*.sock"):
            if path not in known:
                path.unlink()
        for user in {path.name for root in (self._root, self._sockets) for path in _directories(root)}:
            self._sweep(user)

    def _sweep(self, user: str) -> None:
        """Remove the directories of a user who has no environment; an environment may have left files there."""
        if any(name.partition("/")[0] == user for name in self._environments):
            return
        with suppress(FileNotFoundError):
            (self._root / user).rmdir()
        if (self._sockets / user).is_dir():
            shutil.rmtree(self._sockets / user)

    # --- ends ---------------------------------------------------------------------------------------------------------

    def _happened(self, event: Event) -> None:
        run = event["Actor"]["Attributes"][RUN]
        name = next((name for name, each in self._environments.items() if each.run == run), None)
        if name is None:
            return
        if event["Action"] == "oom":
            self.limit_hit(name, run, "its memory was used up, and a process in it was ended for that")
        else:
            self._look(self._see(name, run))

    def _taken_up(self) -> None:
        if self._following.is_set():
            self._look(self._see_all())
            self._look(self._networks.guard())
        self._following.set()

    async def _see(self, name: str, run: str) -> None:
        """Report the end of an environment with what Docker knows of it."""
        state = await self._daemon.state(run)
        if state is None:
            self.died(name, run, "was removed", None)
            return
        status, reason = describe(state)
        self.died(name, run, reason, status)

    async def _see_all(self) -> None:
        """Docker was away: whatever does not run now has ended."""
        present = await self._daemon.present()
        alive = {found.run for found in present if found.running}
        for name, life in self.running().items():
            if life.run not in alive:
                await self._see(name, life.run)
        for name in {found.name for found in present} | set(self._environments):
            if name not in self.running():  # a start that failed while Docker was away
                self.stray(name)

    def _look(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(work)
        self._looking.add(task)
        task.add_done_callback(self._looked)

    def _looked(self, task: asyncio.Task[None]) -> None:
        self._looking.discard(task)
        if not task.cancelled() and (error := task.exception()):
            log.error("Docker could not be asked: {error}", error=str(error))


def _directories(parent: Path) -> list[Path]:
    return sorted(path for path in parent.iterdir() if path.is_dir()) if parent.is_dir() else []
