"""The engine `process`: each environment is a process tree with a directory and a ROS domain of its own.

It is meant for development and for single robots. Programs in an environment run as this user: they can read what this
user can read. Limits of memory, processes and cores are enforced where this user may make control groups (cgroups.py);
elsewhere a program can also escape from being killed with its environment by changing its environment variables
(tree.py).
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from msgspec import Struct
from twisted.logger import Logger

from containers import logfile
from containers.data_relay import GATE, DataRelay
from containers.engine import LAST_LINES, Engine, EnvironmentEnded, RunningEnvironment
from containers.packages import package_directories, package_path
from containers.process import shared_memory
from containers.process.cgroups import ControlGroups
from containers.process.domains import Domains
from containers.process.options import NEVER_ENFORCED, check_options
from containers.process.prepared import Pool, Prepared
from containers.process.tree import KILL_TIMEOUT, MARKER, Watch, describe_end, has_marker, kill_marked
from containers.process.usage import used_below
from containers.recordings.receiver import RecordingReceiver
from containers.trash import Trash
from rce.bag.transfer import SOCKET as RECORDINGS
from rce.control.calls.environments import EnvironmentSpec
from rce.control.calls.watching import EnvironmentUsage
from rce.errors import StartFailed, TimedOut, disk_full
from rce.process.host import host_identity

log = Logger()
COMMAND: Sequence[str] = (sys.executable, "-P", "-m", "endpoints.environment")
STOP_TIMEOUT = 10.0  # seconds; the endpoint stops its nodes by SIGINT, SIGTERM and SIGKILL in less time
TRIM_INTERVAL = 5.0  # seconds
SOCKET = "data.sock"
# Variables about the machine, its network and a system ROS 2 that processes need; all others may hold secrets.
INHERITED_VARIABLES = (
    *("PATH", "LANG", "LC_ALL", "LC_CTYPE", "TZ"),
    *("SSL_CERT_FILE", "SSL_CERT_DIR", "REQUESTS_CA_BUNDLE", "CURL_CA_BUNDLE", "PIP_CERT"),
    *("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION"),
)


class _State(Struct, frozen=True):
    """State for the next task set, in `state.json` of the environment's directory."""

    name: str
    run: str
    size: int
    pid: int
    domain: int
    group: str = ""
    marker: str = ""  # of a process that was prepared; empty: the run


@dataclass
class _Environment:
    state: _State
    directory: Path
    watch: Watch
    child: subprocess.Popen[bytes] | None  # None if an earlier task set started it
    lock: int | None  # file descriptor that holds the domain; None if only the process itself holds it


class ProcessEngine(Engine):
    """Runs environments as process trees. No other task set may use the same `root`."""

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[EnvironmentEnded], None],
        *,
        root: Path,
        packages: Path,
        settings: Mapping[str, str],
        command: Sequence[str] | None = None,
        domains: Domains | None = None,
        relay: DataRelay | None = None,
        recordings: RecordingReceiver | None = None,
        warm: int = 0,
    ) -> None:
        """Prepare the engine.

        Args:
            capacity: Number of slots.
            features: Special features of the machine.
            ended: Called for each environment that ended by itself.
            root: Directory of the environments.
            packages: Directory of users' packages.
            settings: Settings of every Environment endpoint (`RCE_…` in its environment variables).
            command: Command that starts an endpoint.
            domains: ROS domains to allocate from.
            relay: Data relay that environments are added to.
            recordings: Receiver of the recordings of environments.
            warm: Number of endpoints that are started before their environments are known.
        """
        super().__init__(capacity, features, ended)
        self._root = root
        self._packages = packages
        self._trash = Trash(root.with_name("trash"))
        self._settings = dict(settings)
        self.host = self._settings.get("host") or host_identity()
        self.sockets = f"{root}/{{name}}/{{run}}/{SOCKET}"
        self._command = command or COMMAND
        self._domains = domains or Domains()
        self._relay = relay or DataRelay()
        self._recordings = recordings or RecordingReceiver()
        self._pool = Pool(warm, self._domains, self._common_variables())
        self._environments: dict[str, _Environment] = {}
        self._groups = ControlGroups(f"rce-{hashlib.sha256(bytes(root)).hexdigest()[:16]}")
        self._killed: dict[str, int] = {}  # processes that exceeded the memory limit, by run
        self._trimmer: asyncio.Task[None] | None = None

    @property
    def not_enforced(self) -> list[str]:
        """Options that have no effect: what control groups cannot limit, and what this user may not limit by them."""
        return [*NEVER_ENFORCED, *sorted({"cpu", "memory", "pids"} - self._groups.enforced)]

    async def launch(self, spec: EnvironmentSpec) -> None:
        """Start the process in a ROS domain that no other environment uses."""
        check_options(spec, self.not_enforced)
        try:
            state = self._start_process(spec, None if spec.group else self._pool.take())
            directory = self._environments[spec.name].directory
            _write(directory / "state.json", msgspec.json.encode(state))
            await self._connect(spec.name, directory)
        except OSError as error:
            raise StartFailed(f"environment {spec.name} did not start: {disk_full(error) or error}") from None

    async def _connect(self, name: str, directory: Path) -> None:
        await self._relay.add_environment(name, directory / SOCKET, directory)
        self._recordings.add_environment(name, directory)

    async def remove(self, name: str) -> None:
        """Stop the process, kill what it left running, and remove its directory and shared memory."""
        self._relay.remove_environment(name)
        environment = self._environments.get(name)
        if environment is not None and not environment.watch.ended.is_set():
            await self._terminate(environment)
        self._recordings.remove_environment(name)  # after its end, at which it completes them
        for directory in _directories(self._root / name):
            await kill_marked(directory.name)
            await asyncio.to_thread(self._groups.remove, directory.name)
            await asyncio.to_thread(shared_memory.remove_secrets, directory.name)
            await self._trash.discard(directory)
        _remove_if_empty(self._root / name)
        _remove_if_empty((self._root / name).parent)
        if environment is not None:
            del self._environments[name]
            self._killed.pop(environment.state.run, None)
            try:
                await asyncio.to_thread(_clean_shared_memory, self._vacated_domain(environment))
            finally:
                self._release(environment)

    def _vacated_domain(self, environment: _Environment) -> int | None:
        """Return the environment's ROS domain if this process holds it and no other environment is in it.

        The domain must be cleaned before it is released: its next user would lose the ports that it has just created.
        """
        domain = environment.state.domain
        shared = any(other.state.domain == domain for other in self._environments.values())
        return None if shared or environment.lock is None else domain

    async def recover(self) -> dict[str, RunningEnvironment]:
        """Adopt processes that run, and remove the directories and processes of all others."""
        self._root.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._trash.open()
        for user in _directories(self._root):
            for tag in _directories(user):
                await self._recover_runs(tag)
                _remove_if_empty(tag)
            _remove_if_empty(user)
        runs = [each.state.run for each in self._environments.values()]
        await asyncio.to_thread(self._groups.open, runs)
        await asyncio.to_thread(shared_memory.clean)  # of processes killed while no task set ran
        self._trimmer = asyncio.create_task(self._trim())
        self._pool.fill()
        return {name: RunningEnvironment(each.state.run, each.state.size) for name, each in self._environments.items()}

    async def _recover_runs(self, parent: Path) -> None:
        for directory in _directories(parent):
            if not await self._adopt(directory):
                log.info("removing the remains of {directory}", directory=str(directory))
                await kill_marked(directory.name)
                self._trash.take(directory)

    async def last_lines(self, name: str) -> list[str]:
        """Return the last lines of the process's log file."""
        environment = self._environments[name]
        return await asyncio.to_thread(logfile.last_lines, _log_file(environment.directory), LAST_LINES)

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the resources that process trees have used, from /proc."""
        pids = {name: each.state.pid for name, each in self._environments.items()}
        found = await asyncio.to_thread(used_below, list(pids.values()))
        return {name: found[pid] for name, pid in pids.items() if pid in found}

    async def release(self) -> None:
        """Stop watching the processes."""
        if self._trimmer is not None:
            self._trimmer.cancel()
        self._pool.close()
        while self._environments:
            name, environment = self._environments.popitem()
            self._relay.remove_environment(name)
            self._recordings.remove_environment(name)
            self._release(environment)
        self._groups.close()
        await self._trash.close()

    def _release(self, environment: _Environment) -> None:
        environment.watch.close()
        if environment.lock is not None:
            os.close(environment.lock)  # a running process has inherited the lock and still holds the domain

    # --- starting -----------------------------------------------------------------------------------------------------

    def _domain(self, spec: EnvironmentSpec) -> tuple[int, int | None]:
        """Return a ROS domain and the file descriptor that holds it.

        The members of a network group share a domain; a group has no other effect in this engine.
        """
        group = spec.group.name if spec.group else ""
        for other in self._environments.values():
            if group and other.state.group == group:
                return other.state.domain, None if other.lock is None else os.dup(other.lock)
        return self._domains.take()

    def _start_process(self, spec: EnvironmentSpec, prepared: Prepared | None) -> _State:
        domain, lock = (prepared.domain, prepared.lock) if prepared else self._domain(spec)
        directory = self._root / spec.name / spec.run
        try:
            (directory / "home").mkdir(parents=True, mode=0o700)
            self._groups.create(spec.run, spec.options)  # after the directory, by which it is found and removed
            variables = self._environ(spec, directory, domain)
            if prepared is not None:
                child = prepared.child
                self._groups.add(spec.run, child.pid)
                prepared.begin(variables, directory, _log_file(directory))
            else:
                child = self._start_anew(directory, variables, lock)
        except OSError:
            if prepared is not None:
                prepared.child.kill()
                prepared.child.wait()
            if lock is not None:
                os.close(lock)
            raise
        group, marker = spec.group.name if spec.group else "", prepared.marker if prepared else ""
        state = _State(spec.name, spec.run, spec.options.size, child.pid, domain, group, marker)
        self._watch(state, directory, child, lock)
        self._groups.add(spec.run, child.pid)
        return state

    def _start_anew(self, directory: Path, variables: Mapping[str, str], lock: int | None) -> subprocess.Popen[bytes]:
        with _log_file(directory).open("ab") as output:
            return subprocess.Popen(
                self._command,
                cwd=directory,
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=[] if lock is None else [lock],
            )

    def _common_variables(self) -> dict[str, str]:
        """Return the variables of every endpoint."""
        return {
            **{key: os.environ[key] for key in INHERITED_VARIABLES if key in os.environ},
            **{f"RCE_{key.upper()}": value for key, value in self._settings.items()},
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        }

    def _environ(self, spec: EnvironmentSpec, directory: Path, domain: int) -> dict[str, str]:
        packages = package_path(package_directories(self._packages, spec.packages), self._settings)
        return {
            **self._common_variables(),
            **{f"RCE_{key.upper()}": value for key, value in packages.items()},
            "HOME": str(directory / "home"),
            MARKER: spec.run,
            "RCE_NAME": spec.name,
            "RCE_TOKEN": spec.token,
            "RCE_DATA_DIR": str(directory),
            "RCE_SOCKET": str(directory / SOCKET),
            "RCE_RELAY": str(directory / GATE),
            **({"RCE_RECORDINGS": str(directory / RECORDINGS)} if self._recordings.active else {}),
            "RCE_ENV": msgspec.json.encode(spec.options.env).decode(),
            "ROS_DOMAIN_ID": str(domain),
        }

    def _watch(self, state: _State, directory: Path, child: subprocess.Popen[bytes] | None, lock: int | None) -> None:
        watch = Watch(state.pid, lambda: self._process_ended(state.name))
        self._environments[state.name] = _Environment(state, directory, watch, child, lock)

    async def _adopt(self, directory: Path) -> bool:
        """Watch the process of this directory if it runs; return False if it does not."""
        try:
            state = msgspec.json.decode((directory / "state.json").read_bytes(), type=_State)
        except (FileNotFoundError, msgspec.DecodeError):
            return False  # the task set was killed before it started the process, or just after
        try:
            self._watch(state, directory, None, None)
        except ProcessLookupError:
            return False
        # Checked while the watch holds the pid, which may have been reused.
        if has_marker(state.pid, state.marker or state.run):
            await self._connect(state.name, directory)
            return True
        self._environments.pop(state.name).watch.close()
        return False

    # --- ending -------------------------------------------------------------------------------------------------------

    def _process_ended(self, name: str) -> None:
        environment = self._environments[name]
        if environment.lock is None:  # hold the domain, as nodes may still be in it
            environment.lock = self._domains.hold(environment.state.domain)
        status = environment.child.wait() if environment.child is not None else None
        self.report_end(name, environment.state.run, describe_end(status), status)

    async def _terminate(self, environment: _Environment) -> None:
        name, watch = environment.state.name, environment.watch
        for number, timeout in ((signal.SIGTERM, STOP_TIMEOUT), (signal.SIGKILL, KILL_TIMEOUT)):
            watch.send(number)
            try:
                await asyncio.wait_for(watch.ended.wait(), timeout)
                return
            except TimeoutError:
                log.warn("{name} still runs {seconds} s after {signal}", name=name, seconds=timeout, signal=number.name)
        raise TimedOut(f"the process of environment {name} still runs {KILL_TIMEOUT:g} s after it was killed")

    async def _trim(self) -> None:
        while True:
            await asyncio.sleep(TRIM_INTERVAL)
            for name, environment in self._environments.items():
                try:
                    logfile.trim(_log_file(environment.directory))
                except OSError as error:  # most likely the disk is full; the next round may succeed
                    log.error("the log of {name} cannot be trimmed: {error}", name=name, error=str(error))
                self._report_killed(name, environment.state.run)

    def _report_killed(self, name: str, run: str) -> None:
        killed = self._groups.killed(run)
        if killed > self._killed.get(run, 0):
            self.report_limit(name, run, "it reached its memory limit, and the kernel killed one of its processes")
        self._killed[run] = killed


def _clean_shared_memory(domain: int | None) -> None:
    shared_memory.clean()
    if domain is not None:
        shared_memory.clean_ports(domain)


def _log_file(directory: Path) -> Path:
    return directory / "endpoint.log"


def _directories(parent: Path) -> list[Path]:
    return sorted(path for path in parent.iterdir() if path.is_dir()) if parent.is_dir() else []


def _remove_if_empty(directory: Path) -> None:
    if directory.is_dir() and not any(directory.iterdir()):
        directory.rmdir()


def _write(path: Path, content: bytes) -> None:
    """Write a file atomically, even if the process is killed meanwhile."""
    draft = path.with_suffix(".new")
    draft.write_bytes(content)
    draft.rename(path)
