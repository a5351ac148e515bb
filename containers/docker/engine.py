"""The engine `docker`: each environment is a container without a network on this machine's Docker.

A container is connected to the platform by two directories only. One holds the socket of the relay to the Master
(control_relay.py). The other, shared by the environments of one user, holds the sockets on which their endpoints accept
data links. So nothing that an environment sends reaches another user's environments, the host or the network. Both are
read-only for environments: the platform makes all sockets (data_socket.py).

Containers carry labels, by which they are adopted after a restart of the task set. Their ends are reported by Docker's
event stream; nothing is polled.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Collection, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from twisted.logger import Logger

from containers.control_relay import ControlRelay
from containers.data_relay import GATE, DataRelay
from containers.data_socket import DataSocket
from containers.docker import disks, shaping
from containers.docker.block_io import Machine
from containers.docker.daemon import RUN, Daemon, Found, describe
from containers.docker.events import Event
from containers.docker.networks import Networks
from containers.docker.options import container_options
from containers.docker.setup import Setup
from containers.endpoint import CONTROL, EndpointPaths, environment_user, reference, variables
from containers.engine import LAST_LINES, Engine, EnvironmentEnded, RunningEnvironment
from containers.limits import Size, limits
from containers.logfile import LONGEST_LINE
from containers.packages import package_directories, package_path
from containers.recordings.receiver import RecordingReceiver
from containers.settings import EGRESS_POOL, NAMESERVERS
from containers.trash import Trash
from rce.bag.transfer import SOCKET as RECORDINGS
from rce.control.calls.environments import EnvironmentSpec
from rce.control.calls.watching import EnvironmentUsage
from rce.errors import NoCapacity, StartFailed, Unavailable, disk_full
from rce.process.host import host_identity

log = Logger()
MOST_REMAINS = 1000  # files that are looked at in the directory of a user's sockets


@dataclass
class _Environment:
    """State of an environment in this process; Docker has the rest."""

    run: str
    paths: EndpointPaths
    relay: ControlRelay
    data_socket: DataSocket
    gpus: Sequence[str]

    def close(self) -> None:
        """Close the sockets to the platform."""
        self.relay.close()
        self.data_socket.close()


class DockerEngine(Engine):
    """Runs environments as containers. No other task set may use the same directory."""

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[EnvironmentEnded], None],
        setup: Setup,
        *,
        gpus: int = 0,
        relay: DataRelay | None = None,
        recordings: RecordingReceiver | None = None,
        host: str = "",
        egress_pool: str = EGRESS_POOL,
        nameservers: Sequence[str] = NAMESERVERS,
    ) -> None:
        """Prepare the engine; arguments are as in `containers.settings.Settings`.

        `relay` is the data relay that environments are added to, and `recordings` receives what they record.
        """
        super().__init__(capacity, features, ended)
        self.gpus = gpus
        self._setup = setup
        self._root = setup.directory / "environments"
        self._sockets = setup.directory / "sockets"
        self.sockets = f"{self._sockets}/{{user}}/{{run}}.sock"
        self._packages = setup.directory / "packages"
        self._trash = Trash(setup.directory / "trash")
        self._recordings = recordings or RecordingReceiver()
        self._settings = {**setup.settings, "relay": f"{CONTROL}/{GATE}"}
        if self._recordings.active:
            self._settings["recordings"] = f"{CONTROL}/{RECORDINGS}"
        self._data_relay = relay or DataRelay()
        self.host = host or host_identity()
        self._daemon = Daemon(setup.labels)
        self._networks = Networks(self._daemon.call, setup.labels, egress_pool, nameservers)
        self._environments: dict[str, _Environment] = {}
        self._master = setup.master
        self._background: set[asyncio.Task[None]] = set()
        self._watch: asyncio.Task[None] | None = None  # of the packet filter
        self._following = asyncio.Event()  # set when Docker's event stream has begun
        self._ended_early: set[str] = set()  # runs whose end was reported while `recover` had not yet adopted them
        self._machine = Machine()

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Create the container, its networks, its disk and its sockets, and start it."""
        gpus = self._free_gpus(spec)
        granted = limits(spec, gpus, Size.here())
        if spec.options.disk:
            disks.check(spec.options.disk)
        if spec.options.bandwidth and (spec.group is not None or spec.egress != "none"):
            shaping.check()
        packages = package_directories(self._packages, spec.packages)
        with_packages = package_path(packages, self._settings)
        read_only = [*self._setup.read_only, *packages]
        try:
            environment = await self._connect(spec.name, spec.run, gpus)
            networks = await self._networks.join(spec)
            disk = await self._disk(spec)
            try:
                await self._daemon.start(
                    Found("", spec.name, spec.run, spec.options.size, running=False, gpus=gpus),
                    reference(spec.options.image) if spec.options.image else self._setup.image,
                    self._setup.command,
                    variables(spec, environment.paths, self.host, self._settings | with_packages),
                    container_options(
                        self._user(spec.name), granted, environment.paths, read_only, networks, disk, self._machine
                    ),
                )
                await self._shape(spec, len(networks.networks))
            finally:
                if disk is not None:  # the device stays as long as it is mounted
                    await asyncio.to_thread(disks.detach, disk)
        except (OSError, Unavailable) as error:
            reason = (disk_full(error) if isinstance(error, OSError) else None) or error
            raise StartFailed(f"environment {spec.name} did not start: {reason}") from None

    def _free_gpus(self, spec: EnvironmentSpec) -> list[str]:
        """Choose GPUs that no other environment uses; return their numbers.

        Raises:
            NoCapacity: Fewer GPUs are free than the environment asks for.
        """
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
        """Limit the bandwidth of an environment's networks; that of data links is limited by their endpoints."""
        if spec.options.bandwidth and networks:
            process_id = await self._daemon.process_id(spec.run)
            devices = [f"eth{number}" for number in range(networks)]
            await asyncio.to_thread(shaping.shape, process_id, devices, spec.options.bandwidth)

    async def _disk(self, spec: EnvironmentSpec) -> disks.Disk | None:
        if not spec.options.disk:
            return None
        file = self._root / spec.name / f"{spec.run}.disk"
        return await asyncio.to_thread(disks.make, file, spec.options.disk, self._user(spec.name))

    def _user(self, name: str) -> int:
        return environment_user(name, mapped=self._machine.maps_users)

    async def remove(self, name: str) -> None:
        """Remove the container, networks, sockets and directories of an environment."""
        self._data_relay.remove_environment(name)
        await self._daemon.remove(name)
        self._recordings.remove_environment(name)  # after its end, at which it completes them
        await self._networks.leave(name)
        environment = self._environments.get(name)
        if environment is not None:
            environment.close()
            await self._trash.discard(environment.paths.socket)
        await self._trash.discard(self._root / name)
        self._environments.pop(name, None)
        self._sweep(name.partition("/")[0])

    async def recover(self) -> dict[str, RunningEnvironment]:
        """Adopt running containers and remove the rest.

        Raises:
            Unavailable: Docker does not answer.
        """
        for directory in (self._root, self._sockets):
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._trash.open()
        await self._daemon.connect(self._on_event, self._on_resumed)
        self._machine = await self._daemon.machine()
        await self._following.wait()  # before containers are listed, so that no end is missed
        adopted: dict[str, RunningEnvironment] = {}
        for found in await self._daemon.present():
            if found.running and self._paths(found.name, found.run).control.is_dir():
                await self._connect(found.name, found.run, found.gpus)
                adopted[found.name] = RunningEnvironment(found.run, found.size)
                if found.run in self._ended_early:
                    self._spawn_background(self._report_ended(found.name, found.run))
            else:
                log.info("removing the remains of {name}", name=found.name)
                await self._daemon.remove(found.name)
        await self._networks.recover()
        self._watch = asyncio.create_task(self._networks.watch())
        await self._remove_leftovers()
        return adopted

    async def last_lines(self, name: str) -> list[str]:
        """Return the last lines of a container's output."""
        lines = await self._daemon.last_lines(self._environments[name].run, LAST_LINES)
        return [line[:LONGEST_LINE] for line in lines]

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the resources that environments have used, as Docker measures them."""
        return await self._daemon.usage()

    async def release(self) -> None:
        """Stop following Docker's events and close the sockets of environments."""
        self._daemon.close()
        for task in (*self._background, *filter(None, [self._watch])):
            task.cancel()
        for name, environment in self._environments.items():
            environment.close()
            self._data_relay.remove_environment(name)
            self._recordings.remove_environment(name)
        self._environments.clear()
        await self._trash.close()

    def set_master(self, master: str) -> None:
        """Forward the environments' control connections to this Master."""
        self._master = master
        for environment in self._environments.values():
            environment.relay.lead(master)

    # --- directories and sockets --------------------------------------------------------------------------------------

    def _paths(self, name: str, run: str) -> EndpointPaths:
        return EndpointPaths(self._root / name / run, self._sockets / name.partition("/")[0] / f"{run}.sock")

    async def _connect(self, name: str, run: str, gpus: Sequence[str]) -> _Environment:
        """Make the directories of an environment unless they exist, and open its sockets to the platform."""
        paths = self._paths(name, run)
        relay = ControlRelay(self._setup.reactor, self._master, self._setup.tls)
        environment = _Environment(run, paths, relay, DataSocket(paths.socket), gpus)
        self._environments[name] = environment  # from now on `_sweep` keeps the directories of its user
        for directory in (paths.control, paths.socket.parent):
            directory.mkdir(parents=True, exist_ok=True)
            directory.chmod(0o755)  # environments run as other users; they see it by a mount
        environment.data_socket.offer(paths.control)
        await environment.relay.open(paths.control)
        await self._data_relay.add_environment(name, paths.socket, paths.control)
        self._recordings.add_environment(name, paths.control)
        return environment

    async def _remove_leftovers(self) -> None:
        """Remove the directories, sockets and disks of environments that no longer exist."""
        try:
            await asyncio.to_thread(disks.sweep, self._root)
        except StartFailed as error:
            log.error("a disk of an environment that no longer exists was not removed: {error}", error=str(error))
        for path in [tag for user in _directories(self._root) for tag in _directories(user)]:
            if str(path.relative_to(self._root)) not in self._environments:
                self._trash.take(path)
        known = {environment.paths.socket for environment in self._environments.values()}
        for user in {path.name for root in (self._root, self._sockets) for path in _directories(root)}:
            self._sweep(user)
            for path in _some_files(self._sockets / user):
                if path not in known:
                    self._trash.take(path)

    def _sweep(self, user: str) -> None:
        """Remove the directories of a user without environments."""
        if any(name.partition("/")[0] == user for name in self._environments):
            return
        with suppress(OSError):
            (self._root / user).rmdir()
        self._trash.take(self._sockets / user)

    # --- ends ---------------------------------------------------------------------------------------------------------

    def _on_event(self, event: Event) -> None:
        run = event["Actor"]["Attributes"][RUN]
        name = next((name for name, each in self._environments.items() if each.run == run), None)
        if name is None:
            if event["Action"] == "die" and not self._opened.is_set():
                self._ended_early.add(run)
            return
        if event["Action"] == "oom":
            self.report_limit(name, run, "it reached its memory limit, and the kernel killed one of its processes")
        else:
            self._spawn_background(self._report_ended(name, run))

    def _on_resumed(self) -> None:
        if self._following.is_set():
            self._spawn_background(self._check_all())
            self._spawn_background(self._networks.restore_rules())
        self._following.set()

    async def _report_ended(self, name: str, run: str) -> None:
        """Report the end of an environment with the reason that Docker gives, unless it runs.

        It may have been started after the list of containers was read in which it did not run.
        """
        state = await self._daemon.state(run)
        if state is None:
            self.report_end(name, run, "was removed", None)
            return
        if not state.running:
            status, reason = describe(state)
            self.report_end(name, run, reason, status)

    async def _check_all(self) -> None:
        """Report the ends of environments that were missed while Docker's event stream was interrupted."""
        present = await self._daemon.present()
        alive = {found.run for found in present if found.running}
        for name, environment in self.running().items():
            if environment.run not in alive:
                await self._report_ended(name, environment.run)
        for name in {found.name for found in present} | set(self._environments):
            if name not in self.running():  # its start failed while Docker did not answer
                self.report_stray(name)

    def _spawn_background(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(work)
        self._background.add(task)
        task.add_done_callback(self._background_done)

    def _background_done(self, task: asyncio.Task[None]) -> None:
        self._background.discard(task)
        if not task.cancelled() and (error := task.exception()):
            log.error("the state of environments was not read from Docker: {error}", error=str(error))


def _some_files(directory: Path) -> list[Path]:
    """Return files of a directory, but not all of a flood that an earlier version allowed environments to make."""
    try:
        with os.scandir(directory) as entries:
            return [Path(entry.path) for entry in islice(entries, MOST_REMAINS)]
    except OSError:
        return []


def _directories(parent: Path) -> list[Path]:
    return sorted(path for path in parent.iterdir() if path.is_dir()) if parent.is_dir() else []
