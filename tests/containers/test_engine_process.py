"""The process engine keeps the contract; and what only it has: environment variables, markers, domains, directories."""

import asyncio
import json
import os
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from engine_contract import CAPACITY, FEATURES, Endings, EngineContract, World, spec
from msgspec.structs import replace

from containers import process, processes
from containers.data_relay import DataRelay
from containers.domains import Domains
from containers.engine import Ended, Engine, Life
from containers.process import ProcessEngine
from rce.calls.environments import EnvironmentSpec, Group
from rce.errors import InvalidRequest, LimitExceeded, NoCapacity, StartFailed
from rce.messages import ContainerData
from rce.passage import Passage, refused
from rce.sockets import reaching

STAND_IN = (sys.executable, "-I", "-S", str(Path(__file__).with_name("stand_in.py")))


async def until(condition: Callable[[], bool]) -> None:
    """Wait for another process to come as far."""
    async with asyncio.timeout(20):
        while not condition():  # noqa: ASYNC110  # the other process has no way to tell us
            await asyncio.sleep(0.002)


class ProcessWorld(World):
    def __init__(self, directory: Path) -> None:
        self.root = directory / "environments"
        self.domains = Domains(directory / "domains")

    def engine(self, ended: Callable[[Ended], None], *behaviour: str) -> ProcessEngine:
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
        """What the stand-in saw, once it is up."""
        await until(lambda: any(self.root.joinpath(name).glob("*/seen.json")))
        (file,) = self.root.joinpath(name).glob("*/seen.json")
        return dict(json.loads(file.read_text()))

    async def end(self, name: str) -> None:
        await self.seen(name)
        run = self.alive()[name]
        (pid,) = [pid for pid, environ in self._processes() if environ["RCE_RUN"] == run]
        os.kill(pid, signal.SIGUSR1)
        await until(lambda: run not in self.alive().values())

    def there(self) -> set[str]:
        """An empty directory of a user counts under the user's name."""
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


@pytest.fixture
def world(tmp_path: Path) -> ProcessWorld:
    return ProcessWorld(tmp_path)


class TestProcessEngine(EngineContract):
    pass


async def test_environment_variables(
    world: ProcessWorld, engine: ProcessEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("RCE_TOKEN", "the task set's own")
    monkeypatch.setenv("LANG", "C.UTF-8")
    monkeypatch.setenv("SSL_CERT_FILE", "/ca.pem")
    await engine.start(spec())
    environ = (await world.seen("ann/map"))["environ"]
    directory = world.root / "ann" / "map" / spec().run
    assert "AWS_SECRET_ACCESS_KEY" not in environ
    expected = {
        "RCE_NAME": "ann/map",
        "RCE_RUN": spec().run,
        "RCE_TOKEN": "token",
        "RCE_MASTER": "tcp:127.0.0.1:1",
        "RCE_TYPESUPPORT": "/types",
        "RCE_DATA_DIR": str(directory),
        "HOME": str(directory / "home"),
        "LANG": "C.UTF-8",
        "SSL_CERT_FILE": "/ca.pem",
        "PATH": os.environ["PATH"],
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    }
    assert expected.items() <= environ.items()


async def test_each_has_its_own_domain_and_gives_it_back(world: ProcessWorld, engine: ProcessEngine) -> None:
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("ann/b", 2))
    first, second = [(await world.seen(name))["environ"]["ROS_DOMAIN_ID"] for name in ("ann/a", "ann/b")]
    assert first != second
    assert world.domains.hold(int(first)) is None
    await engine.stop("ann/a")
    lock = world.domains.hold(int(first))
    assert lock is not None
    os.close(lock)


async def test_a_domain_is_cleaned_before_others_may_have_it(
    world: ProcessWorld, engine: ProcessEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    await engine.start(spec("ann/a", 1))
    domain = int((await world.seen("ann/a"))["environ"]["ROS_DOMAIN_ID"])
    cleaned: list[tuple[int, int | None]] = []
    monkeypatch.setattr(
        "containers.shared_memory.clean_ports", lambda number: cleaned.append((number, world.domains.hold(number)))
    )
    await engine.stop("ann/a")
    assert cleaned == [(domain, None)]


async def test_members_of_a_group_share_a_domain_until_the_last_is_gone(
    world: ProcessWorld, engine: ProcessEngine
) -> None:
    for number, name in enumerate(("ann/a", "ann/b", "ann/c")):
        group = Group("ann/g", "10.128.0.0/24", f"10.128.0.{number + 2}") if name != "ann/c" else None
        await engine.start(replace(spec(name, number), group=group))
    first, second, third = [
        (await world.seen(name))["environ"]["ROS_DOMAIN_ID"] for name in ("ann/a", "ann/b", "ann/c")
    ]
    assert first == second != third
    await engine.stop("ann/a")
    assert world.domains.hold(int(first)) is None
    await engine.stop("ann/b")
    lock = world.domains.hold(int(first))
    assert lock is not None
    os.close(lock)


async def test_a_domain_stays_taken_without_a_task_set(world: ProcessWorld, engine: ProcessEngine) -> None:
    await engine.start(spec())
    domain = int((await world.seen("ann/map"))["environ"]["ROS_DOMAIN_ID"])
    await engine.close()
    assert world.domains.hold(domain) is None
    again = world.engine(Endings())
    await again.open()
    await again.keep([])
    await again.close()


async def test_no_domain_left(world: ProcessWorld, tmp_path: Path) -> None:
    world.domains = Domains(tmp_path / "domains", range(90, 91))
    engine = world.engine(Endings())
    await engine.open()
    await engine.start(spec("ann/a", 1))
    with pytest.raises(NoCapacity, match="all 1 ROS domains"):
        await engine.start(spec("ann/b", 2))
    assert world.there() == {"ann/a"}
    await engine.stop("ann/a")
    await engine.start(spec("ann/b", 2))
    await engine.keep([])
    await engine.close()


def test_domains_in_which_others_take_part_are_left_alone(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", 7400 + 250 * 95 + 10))
        with pytest.raises(NoCapacity):
            Domains(tmp_path, range(95, 96)).take()
        domain, lock = Domains(tmp_path, range(95, 97)).take()
        os.close(lock)
    assert domain == 96


async def test_children_in_groups_of_their_own_go_too(world: ProcessWorld, endings: Endings) -> None:
    engine = world.engine(endings, "child")
    await engine.open()
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("ann/b", 2))
    children = [(await world.seen(name))["child"] for name in ("ann/a", "ann/b")]
    assert set(children) <= {pid for pid, _ in world._processes()}
    await engine.stop("ann/a")
    (endpoint,) = [pid for pid, environ in world._processes() if pid != children[1]]
    os.kill(endpoint, signal.SIGKILL)
    ended = await endings.next()
    assert (ended.status, ended.reason) == (-9, "was ended by signal 9 (Killed)")
    assert world.there() == set()
    await engine.close()


async def test_one_that_ignores_sigterm_is_killed(
    world: ProcessWorld, endings: Endings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "STOP_TIMEOUT", 0.05)
    engine = world.engine(endings, "stubborn")
    await engine.open()
    await engine.start(spec())
    await world.seen("ann/map")
    ((pid, _),) = world._processes()
    await engine.stop("ann/map")
    assert world.there() == set()
    with pytest.raises(ProcessLookupError):  # not even a zombie
        os.kill(pid, 0)
    await engine.close()


async def test_a_half_started_one_is_removed(world: ProcessWorld, engine: ProcessEngine) -> None:
    """The task set was killed after it had started the process, before it wrote that down."""
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("ann/b", 2))
    await engine.close()
    (world.root / "ann" / "a" / spec(run=1).run / "state.json").unlink()
    (world.root / "bob" / "c" / spec(run=3).run).mkdir(parents=True)
    again = world.engine(Endings())
    await again.open()
    assert again.running() == {"ann/b": Life(spec(run=2).run)}
    assert world.there() == {"ann/b"}
    await again.keep([])
    await again.close()


async def test_an_environment_has_a_gate_to_other_machines_also_once_it_is_adopted(world: ProcessWorld) -> None:
    relay, ended = DataRelay(), Endings()
    engine = world.engine(ended)
    engine._relay = relay
    await engine.open()
    await engine.start(spec("ann/brain"))
    variables = (await world.seen("ann/brain"))["environ"]
    gate = Path(variables["RCE_RELAY"])
    for _ in range(2):
        assert relay._places["ann/brain"].socket == Path(variables["RCE_SOCKET"])
        with reaching(gate) as path:
            reader, writer = await asyncio.open_unix_connection(path)
        writer.write(Passage("bob/brain").line())
        assert refused(await reader.read()) == "another user's"
        writer.close()
        await engine.close()
        assert not relay._places
        engine = world.engine(ended)
        engine._relay = relay
        await engine.open()
    await engine.stop("ann/brain")
    assert not relay._places
    await engine.close()


async def test_a_pid_that_is_another_process_is_not_adopted(world: ProcessWorld, engine: ProcessEngine) -> None:
    await engine.start(spec())
    await engine.close()
    file = world.root / "ann" / "map" / spec().run / "state.json"
    state = json.loads(file.read_text())
    file.write_text(json.dumps({**state, "pid": os.getpid()}))
    again = world.engine(Endings())
    await again.open()
    assert again.running() == {}
    assert world.there() == set()
    await again.close()


async def test_the_reason_of_a_failed_start(world: ProcessWorld, engine: ProcessEngine) -> None:
    world.break_start(engine)
    with pytest.raises(StartFailed, match="No such file or directory: '/nonexistent/program'"):
        await engine.start(spec())


@pytest.mark.parametrize(
    ("options", "error", "field"),
    [
        (ContainerData(cpu=10_000), LimitExceeded, "containerData.cpu"),
        (ContainerData(memory=2**60), LimitExceeded, "containerData.memory"),
    ],
)
async def test_what_this_engine_cannot_give_is_refused(
    engine: ProcessEngine, options: ContainerData, error: type[InvalidRequest | LimitExceeded], field: str
) -> None:
    with pytest.raises(error) as raised:
        await engine.start(EnvironmentSpec("ann/map", spec().run, "token", options))
    assert raised.value.field == field
    assert engine.running() == {}


def test_two_uses_of_a_directory_are_apart(tmp_path: Path) -> None:
    domains = Domains(tmp_path / "domains")
    first, lock = domains.take()
    second, other = domains.take()
    os.close(lock)
    third, again = domains.take()
    os.close(other)
    os.close(again)
    assert (second > first, third) == (True, first)


async def test_shared_memory_of_the_dead_is_removed_by_the_next_task_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cleaned: list[bool] = []
    monkeypatch.setattr(process.shared_memory, "clean", lambda: cleaned.append(True))
    engine = ProcessWorld(tmp_path).engine(Endings())
    await engine.open()
    await engine.close()
    assert cleaned
