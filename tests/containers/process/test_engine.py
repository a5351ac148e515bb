"""The process engine: the contract, environment variables, domains, directories and child processes."""

import asyncio
import errno
import json
import os
import signal
from pathlib import Path

import pytest
from msgspec.structs import replace

from containers.data_relay import DataRelay
from containers.engine import RunningEnvironment
from containers.process import engine as process
from containers.process.domains import Domains
from containers.process.engine import ProcessEngine
from rce.control.calls.environments import Group
from rce.errors import NoCapacity, StartFailed
from rce.net.relay_handshake import RelayRequest, refusal_reason
from rce.net.sockets import unix_socket_path
from rce.process.host import host_identity
from tests.support.containers.engine_contract import Endings, EngineContract, opened, spec, with_options
from tests.support.containers.process_world import ProcessWorld
from tests.support.domains import domain


@pytest.fixture
def world(tmp_path: Path) -> ProcessWorld:
    return ProcessWorld(tmp_path)


class TestProcessEngine(EngineContract):
    pass


async def test_socket_of_an_environment_is_where_the_task_set_says(engine: ProcessEngine) -> None:
    await engine.start(spec("ann/map"))
    path = engine.sockets.replace("{name}", "ann/map").replace("{run}", spec("ann/map").run)
    assert Path(path) == engine._environments["ann/map"].directory / process.SOCKET
    assert engine.host == host_identity()


async def test_endpoint_gets_its_settings_and_no_secrets(
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


async def test_each_environment_has_its_own_domain_until_it_stops(world: ProcessWorld, engine: ProcessEngine) -> None:
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("ann/b", 2))
    first, second = [(await world.seen(name))["environ"]["ROS_DOMAIN_ID"] for name in ("ann/a", "ann/b")]
    assert first != second
    assert world.domains.hold(int(first)) is None
    await engine.stop("ann/a")
    lock = world.domains.hold(int(first))
    assert lock is not None
    os.close(lock)


async def test_domain_is_cleaned_before_it_is_released(
    world: ProcessWorld, engine: ProcessEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    await engine.start(spec("ann/a", 1))
    domain = int((await world.seen("ann/a"))["environ"]["ROS_DOMAIN_ID"])
    cleaned: list[tuple[int, int | None]] = []
    monkeypatch.setattr(
        "containers.process.shared_memory.clean_ports",
        lambda number: cleaned.append((number, world.domains.hold(number))),
    )
    await engine.stop("ann/a")
    assert cleaned == [(domain, None)]


async def test_group_members_share_a_domain_until_the_last_is_removed(
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


async def test_running_process_holds_its_domain_without_a_task_set(world: ProcessWorld, engine: ProcessEngine) -> None:
    await engine.start(spec())
    domain = int((await world.seen("ann/map"))["environ"]["ROS_DOMAIN_ID"])
    await engine.close()
    assert world.domains.hold(domain) is None
    async with opened(world.engine(Endings())):
        pass


async def test_start_fails_if_all_domains_are_in_use(world: ProcessWorld, tmp_path: Path) -> None:
    world.domains = Domains(tmp_path / "domains", [domain("the only one")])
    async with opened(world.engine(Endings())) as engine:
        await engine.start(spec("ann/a", 1))
        with pytest.raises(NoCapacity, match="all 1 ROS domains"):
            await engine.start(spec("ann/b", 2))
        assert world.remains() == {"ann/a"}
        await engine.stop("ann/a")
        await engine.start(spec("ann/b", 2))


async def test_children_in_their_own_process_groups_are_killed(world: ProcessWorld, endings: Endings) -> None:
    async with opened(world.engine(endings, "child")) as engine:
        await engine.start(spec("ann/a", 1))
        await engine.start(spec("ann/b", 2))
        children = [(await world.seen(name))["child"] for name in ("ann/a", "ann/b")]
        assert set(children) <= {pid for pid, _ in world._processes()}
        await engine.stop("ann/a")
        (endpoint,) = [pid for pid, environ in world._processes() if pid != children[1]]
        os.kill(endpoint, signal.SIGKILL)
        ended = await endings.next()
        assert (ended.status, ended.reason) == (-9, "was killed by signal 9 (Killed)")
        assert world.remains() == set()


async def test_process_that_ignores_sigterm_is_killed(
    world: ProcessWorld, endings: Endings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "STOP_TIMEOUT", 0.05)
    async with opened(world.engine(endings, "stubborn")) as engine:
        await engine.start(spec())
        await world.seen("ann/map")
        ((pid, _),) = world._processes()
        await engine.stop("ann/map")
        assert world.remains() == set()
        with pytest.raises(ProcessLookupError):  # not even a zombie
            os.kill(pid, 0)


async def test_half_started_environment_is_removed(world: ProcessWorld, engine: ProcessEngine) -> None:
    """The task set was killed after it had started the process and before it wrote `state.json`."""
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("ann/b", 2))
    await engine.close()
    (world.root / "ann" / "a" / spec(run=1).run / "state.json").unlink()
    (world.root / "bob" / "c" / spec(run=3).run).mkdir(parents=True)
    async with opened(world.engine(Endings())) as again:
        assert again.running() == {"ann/b": RunningEnvironment(spec(run=2).run)}
        assert world.remains() == {"ann/b"}


async def test_directory_of_a_user_whose_last_environment_is_gone_is_removed(world: ProcessWorld) -> None:
    """The task set was killed after it had removed the directory of the tag and before that of the user."""
    (world.root / "ann").mkdir(parents=True)
    async with opened(world.engine(Endings())):
        assert not (world.root / "ann").exists()


async def test_gate_is_open_also_after_adoption(world: ProcessWorld) -> None:
    relay, ended = DataRelay(), Endings()
    engine = world.engine(ended)
    engine._relay = relay
    await engine.open()
    await engine.start(spec("ann/brain"))
    variables = (await world.seen("ann/brain"))["environ"]
    gate = Path(variables["RCE_RELAY"])
    for _ in range(2):
        assert relay._environments["ann/brain"].socket == Path(variables["RCE_SOCKET"])
        with unix_socket_path(gate) as path:
            reader, writer = await asyncio.open_unix_connection(path)
        writer.write(RelayRequest("bob/brain").line())
        assert refusal_reason(await reader.read()) == "another user's"
        writer.close()
        await engine.close()
        assert not relay._environments
        engine = world.engine(ended)
        engine._relay = relay
        await engine.open()
    await engine.stop("ann/brain")
    assert not relay._environments
    await engine.close()


async def test_reused_pid_is_not_adopted(world: ProcessWorld, engine: ProcessEngine) -> None:
    await engine.start(spec())
    await engine.close()
    file = world.root / "ann" / "map" / spec().run / "state.json"
    state = json.loads(file.read_text())
    file.write_text(json.dumps({**state, "pid": os.getpid()}))
    async with opened(world.engine(Endings())) as again:
        assert again.running() == {}
        assert world.remains() == set()


async def test_failed_start_has_a_reason(world: ProcessWorld, engine: ProcessEngine) -> None:
    world.break_start(engine)
    with pytest.raises(StartFailed, match="No such file or directory: '/nonexistent/program'"):
        await engine.start(spec())


async def test_start_without_room_on_the_disk_says_so(
    world: ProcessWorld, engine: ProcessEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, content: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(process, "_write", refuse)
        with pytest.raises(StartFailed, match="ann/map did not start: disk full"):
            await engine.start(spec())
    await engine.start(spec())


async def test_opening_cleans_shared_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cleaned: list[bool] = []
    monkeypatch.setattr("containers.process.shared_memory.clean", lambda: cleaned.append(True))
    async with opened(ProcessWorld(tmp_path).engine(Endings())):
        assert cleaned


async def test_limits_are_those_of_a_control_group(world: ProcessWorld, engine: ProcessEngine) -> None:
    if "memory" in engine.not_enforced:
        pytest.skip("this user cannot make control groups")
    assert engine.not_enforced == ["bandwidth", "disk", "egress", "io"]
    await engine.start(with_options(memory=2**30))
    run = world.alive()["ann/map"]
    pid = engine._environments["ann/map"].state.pid
    group = engine._groups._groups["memory"] / run
    assert str(pid) in (group / "cgroup.procs").read_text().split()
    await engine.stop("ann/map")
    assert not group.exists()


async def test_start_that_fails_leaves_no_control_group(world: ProcessWorld, engine: ProcessEngine) -> None:
    world.break_start(engine)
    with pytest.raises(StartFailed):
        await engine.start(with_options(memory=2**30))
    assert not [run for group in engine._groups._groups.values() for run in group.iterdir() if run.is_dir()]


async def test_process_beyond_its_memory_limit_is_reported(
    engine: ProcessEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    reported: list[tuple[str, str]] = []
    engine.on_limit = lambda name, run, reason: reported.append((name, reason))
    await engine.start(spec())
    monkeypatch.setattr(engine._groups, "killed", lambda run: 1)
    for _ in range(2):
        engine._report_killed("ann/map", spec().run)
    assert reported == [("ann/map", "it reached its memory limit, and the kernel killed one of its processes")]
