# ruff: noqa: E402  (imports after importorskip)
"""The engine `docker` with a real daemon: the contract, and the confinement of environments."""

from __future__ import annotations

import asyncio
import os
import re
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.support.containers.engine_contract import Endings, opened, spec, with_options

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker import seccomp
from containers.docker.daemon import Found
from containers.docker.engine import DockerEngine
from containers.docker.events import Event
from containers.endpoint import environment_user
from containers.engine import RunningEnvironment
from containers.recordings.receiver import RecordingReceiver
from containers.recordings.store import RecordingStore
from rce.control.calls.recordings import RecordingQuota
from rce.errors import InvalidRequest, LimitExceeded, StartFailed, Unavailable
from rce.protocol.slots import MB, PIDS
from tests.support.containers.container_contract import ContainerEngineContract, start_confined
from tests.support.containers.container_world import COMMAND
from tests.support.containers.docker_world import DockerWorld
from tests.support.containers.trees import cleared, nest


@pytest.fixture
def world(docker_world: DockerWorld) -> DockerWorld:
    return docker_world


class TestDockerEngine(ContainerEngineContract):
    pass


async def test_socket_of_an_environment_is_where_the_task_set_says(world: DockerWorld, engine: DockerEngine) -> None:
    path = engine.sockets.replace("{user}", "ann").replace("{run}", spec().run)
    assert path == str(engine._paths("ann/map", spec().run).socket)


async def test_container_is_confined(world: DockerWorld, engine: DockerEngine) -> None:
    seen = await start_confined(world, engine)
    host = seen["HostConfig"]
    assert host["SecurityOpt"] == ["no-new-privileges", f"seccomp={seccomp.profile()}"]
    assert host["NetworkMode"] == "none"
    assert host["RestartPolicy"]["Name"] == "no"
    assert host["MemorySwap"] == 300 * MB
    user = environment_user("ann/map")
    assert seen["Config"]["User"] == f"{user}:{user}"
    binds = {mount["Destination"]: (mount["Source"], mount["RW"]) for mount in seen["Mounts"]}
    assert binds == {
        "/run/rce": (str(world.directory / "environments" / "ann" / "map" / spec().run), False),
        str(world.directory / "sockets" / "ann"): (str(world.directory / "sockets" / "ann"), False),
    }


async def test_environment_records_through_its_socket(world: DockerWorld, endings: Endings, tmp_path: Path) -> None:
    store = RecordingStore(tmp_path / "recordings")
    receiver = RecordingReceiver(store)
    asked: list[tuple[str, str]] = []

    async def ask(environment: str, recorder: str) -> RecordingQuota:
        asked.append((environment, recorder))
        return RecordingQuota()

    receiver.ask_quota = ask
    async with opened(world.engine(endings, "record", recordings=receiver)) as engine:
        await engine.start(spec())
        async with asyncio.timeout(60):
            while [each.state for each in store.of("ann")] != ["complete"]:  # noqa: ASYNC110  # it has no event
                await asyncio.sleep(0.05)
    await receiver.close()
    assert asked == [("ann/map", "box")]
    assert store.of("ann")[0].size == 16


async def test_fork_bomb_is_stopped_by_the_process_limit(world: DockerWorld, endings: Endings) -> None:
    async with opened(world.engine(endings, "fork")) as engine:
        await engine.start(spec())
        ended = await endings.next()
        (created,) = re.findall(r"(\d+) processes", "\n".join(ended.lines))
        assert int(created) < PIDS


async def test_users_do_not_share_kernel_limits(world: DockerWorld, endings: Endings) -> None:
    async with opened(world.engine(endings, "inotify")) as engine:
        made = []
        for number, name in enumerate(("ann/a", "bob/b")):
            await engine.start(spec(name, number))
            async with asyncio.timeout(60):
                while "ready" not in (lines := await engine.last_lines(name)):  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            made.append(lines[0])
        assert made[0] == made[1]


async def test_missing_image_is_reported(world: DockerWorld, endings: Endings) -> None:
    async with opened(world.engine(endings, image="rce-test/nothing:1")) as engine:
        with pytest.raises(StartFailed, match=r"no image rce-test/nothing:1.*provision image"):
            await engine.start(spec())
        assert world.remains() == set()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"cpu": 10_000}, LimitExceeded),
        ({"memory": 2**60}, LimitExceeded),
        ({"disk": 1000}, InvalidRequest),
    ],
)
async def test_request_for_more_than_the_machine_has_is_refused(
    engine: DockerEngine, options: dict[str, Any], error: type[LimitExceeded | InvalidRequest]
) -> None:
    with pytest.raises(error) as raised:
        await engine.start(with_options(**options))
    assert raised.value.field == f"containerData.{next(iter(options))}"


async def test_leftovers_of_a_killed_task_set_are_removed(world: DockerWorld, engine: DockerEngine) -> None:
    """The task set was killed after it had created a container, and after it had made directories."""
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("ann/b", 2))
    await engine.close()
    api, image = world.api, world.image
    labels = {"rce.platform": "machine", "rce.directory": str(world.directory), "rce.size": "1"}
    api.create_container(image, COMMAND, labels={**labels, "rce.environment": "bob/c", "rce.run": spec(run=3).run})
    (world.directory / "environments" / "eve" / "d" / spec(run=4).run).mkdir(parents=True)
    (world.directory / "sockets" / "eve").mkdir()
    (world.directory / "sockets" / "ann" / f"{spec(run=5).run}.sock").touch()
    async with opened(world.engine(Endings())) as again:
        assert again.running() == {
            "ann/a": RunningEnvironment(spec(run=1).run),
            "ann/b": RunningEnvironment(spec(run=2).run),
        }
        assert world.remains() == {"ann/a", "ann/b"}
        assert not list((world.directory / "sockets" / "ann").iterdir())


async def test_environment_gets_no_writable_directory_of_the_host(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(spec())
    assert [mount["Destination"] for mount in world.inspect("ann/map")["Mounts"] if mount["RW"]] == []


async def test_floods_of_files_and_directories_stop_neither_recovery_nor_a_start(
    world: DockerWorld, engine: DockerEngine
) -> None:
    """Earlier versions let environments write to the directory of their sockets."""
    with cleared(world.directory):
        await engine.start(spec("ann/a", 1))
        await engine.close()
        for user in ("ann", "eve"):
            sockets = world.directory / "sockets" / user
            sockets.mkdir(exist_ok=True)
            nest(sockets / f"{spec(run=9).run}.sock", 3000)
            for number in range(1500):
                (sockets / str(number)).touch()
        async with opened(world.engine(Endings())) as again:
            assert list(again.running()) == ["ann/a"]
            assert not (world.directory / "sockets" / "eve").exists()
            own = world.directory / "sockets" / "ann" / f"{spec(run=1).run}.sock"
            own.mkdir()
            await again.stop("ann/a")
            await again.start(spec("ann/b", 2))
            await again.start(spec("eve/c", 3))
            assert again.running().keys() == {"ann/b", "eve/c"}


async def test_end_during_adoption_is_reported(
    world: DockerWorld, engine: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of two environments ends when Docker has listed both and the other one is being adopted."""
    names = {"ann/a": "ann/b", "ann/b": "ann/a"}
    for number, name in enumerate(names):
        await engine.start(spec(name, number))
    await engine.close()
    endings, died = Endings(), asyncio.Event()
    again = world.engine(endings)
    connect, on_event = again._connect, again._on_event
    first = ""

    async def connect_slowly(name: str, run: str, gpus: Sequence[str]) -> Any:
        nonlocal first
        if not first:
            first = name
            await world.end(names[name])
            await died.wait()
        return await connect(name, run, gpus)

    def observe(event: Event) -> None:
        on_event(event)
        died.set()

    monkeypatch.setattr(again, "_connect", connect_slowly)
    monkeypatch.setattr(again, "_on_event", observe)
    async with opened(again):
        ended = await endings.next()
        assert (ended.name, ended.status) == (names[first], 3)
        assert list(again.running()) == [first]


async def test_environment_that_started_meanwhile_is_not_taken_for_ended(
    world: DockerWorld, engine: DockerEngine, endings: Endings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Docker's event stream is interrupted; the containers are listed before the environment runs."""
    await engine.start(spec())

    async def present() -> list[Found]:
        return [Found("", "ann/map", spec().run, 1, running=False)]

    monkeypatch.setattr(engine._daemon, "present", present)
    engine._on_resumed()
    await asyncio.gather(*engine._background)
    await asyncio.gather(*engine._tasks)
    assert world.alive() == {"ann/map": spec().run}
    assert endings.none()


async def test_task_sets_on_one_daemon_are_independent(
    world: DockerWorld, engine: DockerEngine, tmp_path: Path
) -> None:
    await engine.start(spec())
    world.directory, own = tmp_path / "other", world.directory
    async with opened(world.engine(Endings())) as other:
        assert other.running() == {}
    world.directory = own
    assert world.alive() == {"ann/map": spec().run}


async def test_opening_without_docker_is_unavailable(
    world: DockerWorld, endings: Endings, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/none.sock")
    with pytest.raises(Unavailable, match="Docker"):
        await world.engine(endings).open()


async def test_environment_reaches_the_master_by_its_relay(world: DockerWorld, endings: Endings) -> None:
    """Both directions are relayed, also after a new task set has replaced the socket of an earlier one."""

    async def shout(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write((await reader.readline()).upper())
        writer.close()

    async with await asyncio.start_server(shout, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        for _ in range(2):
            engine = world.engine(endings, master=f"tcp:127.0.0.1:{port}")
            await engine.open()
            await engine.start(spec())
            assert await asyncio.to_thread(ask, world.directory, b"hello\n") == b"HELLO\n"
            await engine.close()
        async with opened(world.engine(endings)):
            pass


def ask(directory: Path, words: bytes) -> bytes:
    (path,) = (directory / "environments").rglob("control.sock")
    with socket.socket(socket.AF_UNIX) as line:
        handle = os.open(path.parent, os.O_PATH)  # the whole path may be too long for a socket address
        line.connect(f"/proc/self/fd/{handle}/{path.name}")
        os.close(handle)
        line.sendall(words)
        answer = b""
        while part := line.recv(100):
            answer += part
        return answer
