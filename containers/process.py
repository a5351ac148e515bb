"""The engine `process`: an environment is a process with its children, a directory and a ROS domain of its own.

For development and for a single robot. What runs in an environment runs as this user: it can read what this user can
read, no limit is enforced on it (process_options.py), and if it wants to hide from its end (by a changed environment)
it can.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from msgspec import Struct
from twisted.logger import Logger

from containers import logfile, shared_memory
from containers.data_relay import GATE, DataRelay
from containers.domains import Domains
from containers.engine import LAST_LINES, Ended, Engine, Life
from containers.packages import package_path, places
from containers.process_options import check_options
from containers.processes import KILL_TIMEOUT, MARKER, Watch, describe_end, has_marker, kill_marked
from containers.processes_used import used_below
from rce.calls.environments import EnvironmentSpec
from rce.calls.watching import Used
from rce.errors import StartFailed, TimedOut

log = Logger()
COMMAND: Sequence[str] = (sys.executable, "-P", "-m", "endpoints.environment")
STOP_TIMEOUT = 10.0  # the endpoint stops its nodes by SIGINT, SIGTERM, SIGKILL in this time
TRIM_EVERY = 5.0
SOCKET = "data.sock"
# What a process needs of the machine, its network and a system ROS 2; everything else may be a secret.
KEPT = (
    *("PATH", "LANG", "LC_ALL", "LC_CTYPE", "TZ"),
    *("SSL_CERT_FILE", "SSL_CERT_DIR", "REQUESTS_CA_BUNDLE", "CURL_CA_BUNDLE", "PIP_CERT"),
    *("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION"),
)


class _State(Struct, frozen=True):
    """What the next task set must know, in `state.json` of the environment's directory."""

    name: str
    run: str
    size: int
    pid: int
    domain: int
    group: str = ""


@dataclass
class _Environment:
    state: _State
    directory: Path
    watch: Watch
    child: subprocess.Popen[bytes] | None  # None: an earlier task set's
    lock: int | None  # holds the domain; None: only the process itself does


class ProcessEngine(Engine):
    """Environments as process groups; `settings` are those of every Environment endpoint (`RCE_…` in its environment),
    `packages` is where users' packages are.

    The task set must be the only one with this `root`.
    """

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[Ended], None],
        *,
        root: Path,
        packages: Path,
        settings: Mapping[str, str],
        command: Sequence[str] | None = None,
        domains: Domains | None = None,
        relay: DataRelay | None = None,
    ) -> None:
        super().__init__(capacity, features, ended)
        self._root = root
        self._packages = packages
        self._settings = dict(settings)
        self._command = command or COMMAND
        self._domains = domains or Domains()
        self._relay = relay or DataRelay()
        self._environments: dict[str, _Environment] = {}
        self._trimmer: asyncio.Task[None] | None = None

    async def launch(self, spec: EnvironmentSpec) -> None:
        check_options(spec)
        try:
            domain, lock = self._domain(spec)
            state = self._start_process(spec, domain, lock)
            directory = self._environments[spec.name].directory
            _write(directory / "state.json", msgspec.json.encode(state))
            await self._relay.admit(spec.name, directory / SOCKET, directory)
        except OSError as error:
            raise StartFailed(f"environment {spec.name} did not start: {error}") from None

    async def remove(self, name: str) -> None:
        self._relay.dismiss(name)
        environment = self._environments.get(name)
        if environment is not None and not environment.watch.ended.is_set():
            await self._terminate(environment)
        for directory in _directories(self._root / name):
            await kill_marked(directory.name)
            await asyncio.to_thread(shutil.rmtree, directory)
        self._remove_empty(self._root / name)
        if environment is not None:
            del self._environments[name]
            try:
                await asyncio.to_thread(_clean_shared_memory, self._empty_domain(environment))
            finally:
                self._let_go(environment)

    def _empty_domain(self, environment: _Environment) -> int | None:
        """Its ROS domain if we hold that and nobody is in it any more. It is let go only after it was cleaned: whoever
        gets it next would lose the ports that it has just made."""
        domain = environment.state.domain
        shared = any(other.state.domain == domain for other in self._environments.values())
        return None if shared or environment.lock is None else domain

    async def recover(self) -> dict[str, Life]:
        self._root.mkdir(parents=True, exist_ok=True, mode=0o700)
        for parent in [tag for user in _directories(self._root) for tag in _directories(user)]:
            for directory in _directories(parent):
                if not await self._adopt(directory):
                    log.info("removing what is left of {directory}", directory=str(directory))
                    await kill_marked(directory.name)
                    await asyncio.to_thread(shutil.rmtree, directory)
            self._remove_empty(parent)
        await asyncio.to_thread(shared_memory.clean)  # of those that were killed, by whomever, while nobody watched
        self._trimmer = asyncio.create_task(self._trim())
        return {name: Life(each.state.run, each.state.size) for name, each in self._environments.items()}

    async def last_lines(self, name: str) -> list[str]:
        environment = self._environments[name]
        return await asyncio.to_thread(logfile.last_lines, _log_file(environment.directory), LAST_LINES)

    async def usage(self) -> dict[str, Used]:
        pids = {name: each.state.pid for name, each in self._environments.items()}
        found = await asyncio.to_thread(used_below, list(pids.values()))
        return {name: found[pid] for name, pid in pids.items() if pid in found}

    async def release(self) -> None:
        if self._trimmer is not None:
            self._trimmer.cancel()
        while self._environments:
            name, environment = self._environments.popitem()
            self._relay.dismiss(name)
            self._let_go(environment)

    def _let_go(self, environment: _Environment) -> None:
        environment.watch.close()
        if environment.lock is not None:
            os.close(environment.lock)  # a process that runs has inherited it, and goes on holding the domain

    # --- starting -----------------------------------------------------------------------------------------------------

    def _domain(self, spec: EnvironmentSpec) -> tuple[int, int | None]:
        """A ROS domain and what holds it. Members of a network group are in one: that is all that a group is here."""
        group = spec.group.name if spec.group else ""
        for other in self._environments.values():
            if group and other.state.group == group:
                return other.state.domain, None if other.lock is None else os.dup(other.lock)
        return self._domains.take()

    def _start_process(self, spec: EnvironmentSpec, domain: int, lock: int | None) -> _State:
        directory = self._root / spec.name / spec.run
        try:
            (directory / "home").mkdir(parents=True, mode=0o700)
            with _log_file(directory).open("ab") as output:
                child = subprocess.Popen(
                    self._command,
                    cwd=directory,
                    env=self._environ(spec, directory, domain),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    pass_fds=[] if lock is None else [lock],
                )
        except OSError:
            if lock is not None:
                os.close(lock)
            raise
        state = _State(spec.name, spec.run, spec.options.size, child.pid, domain, spec.group.name if spec.group else "")
        self._watch(state, directory, child, lock)
        return state

    def _environ(self, spec: EnvironmentSpec, directory: Path, domain: int) -> dict[str, str]:
        packages = package_path(places(self._packages, spec.packages), self._settings)
        return {
            **{key: os.environ[key] for key in KEPT if key in os.environ},
            **{f"RCE_{key.upper()}": value for key, value in (self._settings | packages).items()},
            "HOME": str(directory / "home"),
            MARKER: spec.run,
            "RCE_NAME": spec.name,
            "RCE_TOKEN": spec.token,
            "RCE_DATA_DIR": str(directory),
            "RCE_SOCKET": str(directory / SOCKET),
            "RCE_RELAY": str(directory / GATE),
            "RCE_ENV": msgspec.json.encode(spec.options.env).decode(),
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        }

    def _watch(self, state: _State, directory: Path, child: subprocess.Popen[bytes] | None, lock: int | None) -> None:
        watch = Watch(state.pid, lambda: self._process_ended(state.name))
        self._environments[state.name] = _Environment(state, directory, watch, child, lock)

    async def _adopt(self, directory: Path) -> bool:
        """Whether the process of this directory lives; then it is watched from now on."""
        try:
            state = msgspec.json.decode((directory / "state.json").read_bytes(), type=_State)
        except (FileNotFoundError, msgspec.DecodeError):
            return False  # the task set was killed before it had started the process, or just after
        try:
            self._watch(state, directory, None, None)
        except ProcessLookupError:
            return False
        if has_marker(state.pid, state.run):  # after the watch holds the pid: it may be another's by now
            await self._relay.admit(state.name, directory / SOCKET, directory)
            return True
        self._environments.pop(state.name).watch.close()
        return False

    # --- ending -------------------------------------------------------------------------------------------------------

    def _process_ended(self, name: str) -> None:
        environment = self._environments[name]
        if environment.lock is None:  # nodes may still be in the domain
            environment.lock = self._domains.hold(environment.state.domain)
        status = environment.child.wait() if environment.child is not None else None
        self.died(name, environment.state.run, describe_end(status), status)

    async def _terminate(self, environment: _Environment) -> None:
        name, watch = environment.state.name, environment.watch
        for number, patience in ((signal.SIGTERM, STOP_TIMEOUT), (signal.SIGKILL, KILL_TIMEOUT)):
            watch.send(number)
            try:
                await asyncio.wait_for(watch.ended.wait(), patience)
                return
            except TimeoutError:
                log.warn("{name} lives {seconds} s after {signal}", name=name, seconds=patience, signal=number.name)
        raise TimedOut(f"the process of environment {name} lives {KILL_TIMEOUT:g} s after it was killed")

    def _remove_empty(self, parent: Path) -> None:
        """Remove the directories of tag and user when nothing is in them."""
        for directory in (parent, parent.parent):
            if directory.is_dir() and not any(directory.iterdir()):
                directory.rmdir()

    async def _trim(self) -> None:
        while True:
            await asyncio.sleep(TRIM_EVERY)
            for name, environment in self._environments.items():
                try:
                    logfile.trim(_log_file(environment.directory))
                except OSError as error:  # a full disk most likely; the next turn may succeed
                    log.error("the log of {name} cannot be cut: {error}", name=name, error=str(error))


def _clean_shared_memory(domain: int | None) -> None:
    shared_memory.clean()
    if domain is not None:
        shared_memory.clean_ports(domain)


def _log_file(directory: Path) -> Path:
    return directory / "endpoint.log"


def _directories(parent: Path) -> list[Path]:
    return sorted(path for path in parent.iterdir() if path.is_dir()) if parent.is_dir() else []


def _write(path: Path, content: bytes) -> None:
    """All of it or nothing, also when the process is killed meanwhile."""
    draft = path.with_suffix(".new")
    draft.write_bytes(content)
    draft.rename(path)
