# ruff: noqa: E402  (imports after importorskip)
"""The platform with the engine `docker`: its images, mapping, and the confinement of environments."""

from __future__ import annotations

import asyncio
import itertools
import json
import statistics
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from tests.support.e2e.consoles import on_terminal, rce, user_environ
from tests.support.e2e.mapping import SCANS, check_files, rce_map, relations
from tests.support.e2e.real_platform import USER, RealPlatform, containers, until
from tests.support.e2e.recordings import piece
from tests.support.e2e.traffic import Echo
from tests.support.paths import DATA

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker.networks import ENVIRONMENT
from provisioning.image import BASE, MAPPING, Builder
from rce import __version__
from rce.api.map_jobs import Job
from rce.client.map_service import MapServiceClient
from rce.control.calls.joining import Hello
from rce.control.client import connect
from rce.control.connection import Handlers
from rce.errors import TimedOut, Unauthorized

STRING = "std_msgs/String"
LARGEST_BASE = 470e6
ATTEMPTS = """
import json, os, socket
def attempt(action):
    try:
        action()
    except OSError as error:
        return error.strerror or str(error)
    return "succeeded"
status = dict(line.split(":\\t") for line in open("/proc/self/status").read().splitlines() if ":\\t" in line)
sockets = os.path.dirname(os.environ["RCE_SOCKET"])
print(json.dumps({
    "uid": os.getuid(),
    "capabilities": [int(status[name], 16) for name in ("CapEff", "CapPrm", "CapBnd", "CapAmb")],
    "no_new_privileges": status["NoNewPrivs"],
    "seccomp": status["Seccomp"],
    "interfaces": os.listdir("/sys/class/net"),
    "write_root": attempt(lambda: open("/opt/rce/x", "w")),
    "write_control": attempt(lambda: open("/run/rce/x", "w")),
    "write_home": attempt(lambda: open("/home/rce/x", "w")),
    "docker": attempt(lambda: os.stat("/var/run/docker.sock")),
    "metadata": attempt(lambda: socket.create_connection(("169.254.169.254", 80), 3)),
    "multicast": attempt(lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"x", ("239.255.0.1", 7400))),
    "users": os.listdir(os.path.dirname(sockets)),
    "mount": attempt(lambda: os.chroot("/tmp")),
}))
"""


def test_base_image_is_small(images: Any) -> None:
    assert images.inspect_image(f"{BASE}:{__version__}")["Size"] < LARGEST_BASE


def test_second_build_changes_nothing(images: Any) -> None:
    tag = f"{MAPPING}:{__version__}"
    before = images.inspect_image(tag)
    Builder(images).build()
    assert images.inspect_image(tag)["Id"] == before["Id"]
    assert before["Config"]["Labels"] == {"rce.version": __version__}


@pytest.mark.skipif(not (DATA / "mit-csail.clf.gz").exists(), reason=f"needs mit-csail.clf.gz in {DATA}, or RCE_DATA")
async def test_real_building_is_mapped(contained: RealPlatform, tmp_path: Path) -> None:
    """A map is made in an environment with one core and 1 GiB."""
    recording = DATA / "mit-csail.clf.gz"
    done = await rce_map(recording, "--url", contained.url, "--out", tmp_path / "map", temporary=tmp_path)
    assert done.status == 0, done.errors
    check_files(tmp_path / "map", SCANS)
    error = await relations(tmp_path / "map" / "trajectory.txt")
    assert error["trans_abs"][0] <= 0.15


@pytest.mark.skipif(not (DATA / "mit-csail.clf.gz").exists(), reason=f"needs mit-csail.clf.gz in {DATA}, or RCE_DATA")
async def test_map_service_job_runs_in_a_container_of_its_user(
    contained: RealPlatform, images: Any, tmp_path: Path
) -> None:
    """The container belongs to the user who submitted the job, and is removed afterwards."""
    service = MapServiceClient(contained.url, user=USER, password=USER)

    def submit_and_watch() -> Job:
        name = service.submit([service.upload(piece(tmp_path / "piece.log", 100)).id]).id
        return list(service.watch(name))[-1]

    seen: set[str] = set()
    watching = asyncio.create_task(asyncio.to_thread(submit_and_watch))
    while not watching.done():
        seen |= {each["Labels"][ENVIRONMENT] for each in await asyncio.to_thread(containers, images, contained)}
        await asyncio.wait([watching], timeout=0.05)
    job = await watching
    assert (job.state, job.scans) == ("done", 100), job
    assert seen == {f"{USER}/map_{job.id}_1"}
    assert containers(images, contained) == []


async def test_map_command_starts_a_platform_of_its_own(images: Any, tmp_path: Path) -> None:
    done = await rce_map("--simulate", "--engine", "docker", "--out", tmp_path / "map", temporary=tmp_path)
    assert done.status == 0, done.errors
    assert not [
        each for each in images.containers(all=True) if str(tmp_path) in each["Labels"].get("rce.directory", "")
    ]


async def test_environments_of_one_user_are_connected(contained: RealPlatform) -> None:
    """A message passes from the robot to a node in one environment, to a node in the other, and back."""
    async with contained.robot("r1") as robot, robot.environment("one") as one, robot.environment("two") as two:
        for environment in (one, two):
            await environment.add_node("echo", "rce_demo", "echo.py")
        await robot.add_interface("one", "out", "SubscriberInterface", STRING, addr="/heard")
        await robot.add_interface("two", "in", "PublisherInterface", STRING, addr="/say")
        await robot.connect("one/out", "two/in")
        await Echo(await one.publisher("/say", STRING), await two.subscriber("/heard", STRING)).answers()


async def test_shared_memory_suffices_for_five_nodes(contained: RealPlatform) -> None:
    """Fast DDS allocates 64 MB of shared memory for each node."""
    async with contained.robot("r7") as robot, robot.environment("full", cpu=2) as full:
        await asyncio.gather(*(full.add_node(f"echo{number}", "rce_demo", "echo.py") for number in range(5)))
        heard = await full.subscriber("/heard", STRING)
        say = await full.publisher("/say", STRING)
        answers: Counter[str] = Counter()
        async with asyncio.timeout(180):
            for attempt in itertools.count():  # the nodes do not all start at once
                await say.publish({"data": str(attempt)})
                with suppress(TimedOut):
                    while answers[str(attempt)] < 5:
                        answers[(await heard.get(1))["data"]] += 1
                if 5 in answers.values():
                    break


async def test_hostile_node_is_confined(contained: RealPlatform, images: Any) -> None:
    async with contained.robot("r2") as robot, robot.environment("hostile"):
        (container,) = [each["Id"] for each in containers(images, contained, "hostile")]
        call = images.exec_create(container, ["python3", "-c", ATTEMPTS])
        output = await asyncio.to_thread(images.exec_start, call["Id"])
        seen = json.loads(output)
    assert seen.pop("uid") != 0
    assert seen.pop("capabilities") == [0, 0, 0, 0]
    assert seen == {
        "no_new_privileges": "1",
        "seccomp": "2",
        "interfaces": ["lo"],
        "write_root": "Read-only file system",
        "write_control": "Read-only file system",
        "write_home": "succeeded",
        "docker": "No such file or directory",
        "metadata": "Network is unreachable",
        "multicast": "Network is unreachable",
        "users": [USER],
        "mount": "Operation not permitted",
    }


async def test_terminal_in_a_container(contained: RealPlatform, tmp_path: Path) -> None:
    env = user_environ(tmp_path, contained.url)
    await rce("env", "create", "lit", env=env)
    await asyncio.to_thread(_converse, env)
    admin = user_environ(tmp_path, contained.url, "admin")
    assert "status 3" in await rce("env", "shell", "--of", USER, "lit", "echo status 3; exit 3", env=admin, status=3)
    await rce("env", "delete", "lit", env=env)


def _converse(env: dict[str, str]) -> None:
    with on_terminal("env", "shell", "lit", env=env) as shell:
        shell.expect("[#$] ")
        shell.type("PS1=ready_; echo $((40 + 2)) $(id -u) $HOME\r")
        shell.expect("42 [1-9][0-9]* /home/rce")
        shell.type("tty; stty size\r")
        shell.expect("/dev/pts/0")
        shell.expect("24 80")
        shell.type("sleep 1000\r")
        shell.expect("sleep 1000")
        shell.type("\x03")  # the prompt comes back whether the shell or the program gets it
        shell.expect("ready_")
        shell.type("python3 -c 'import rclpy; print(rclpy.__name__)'; exit 7\r")
        shell.expect("rclpy\r")  # in the program's output; in the echo of the input more follows
        assert shell.wait() == 7


async def test_joining_the_master_needs_a_credential(
    contained: RealPlatform, reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with contained.robot("r3") as robot, robot.environment("honest"):
        (path,) = (contained.directory / "data" / "container" / "environments" / USER / "honest").rglob("control.sock")
        monkeypatch.chdir(path.parent)  # the whole path may be too long for a socket address
        hello = Hello("environment", f"{USER}/honest", "guessed", __version__)
        with pytest.raises(Unauthorized):
            await connect(reactor, f"unix:{path.name}", hello, Handlers())


async def test_killed_environment_is_restarted(contained: RealPlatform, images: Any) -> None:
    async with contained.robot("r4") as robot, robot.environment("mortal") as mortal:
        (first,) = [each["Id"] for each in containers(images, contained, "mortal")]
        images.kill(first)

        def another() -> bool:
            present = [each["Id"] for each in containers(images, contained, "mortal") if each["State"] == "running"]
            return bool(present) and present != [first]

        await until(another)
        await mortal.add_node("echo", "rce_demo", "echo.py")


async def test_environment_survives_its_task_set(contained: RealPlatform, images: Any) -> None:
    """The task set is killed; the environment works on, and the next task set adopts it."""
    async with contained.robot("r6") as robot, robot.environment("lasting") as lasting:
        echo = await Echo.of(lasting)
        await echo.answers()
        (before,) = [each["Id"] for each in containers(images, contained, "lasting")]
        killed = contained.pid("-m containers ")
        contained.kill(killed)
        await echo.once()
        await until(lambda: contained.pid("-m containers ", but=killed))
        await lasting.add_node("another", "rce_demo", "echo.py")  # the relay to the Master is open again
        assert [each["Id"] for each in containers(images, contained, "lasting")] == [before]
    await until(
        lambda: containers(images, contained, "lasting") == []
    )  # the task set may have to join the Master first


async def test_time_to_start_an_environment(contained: RealPlatform, images: Any, record_property: Any) -> None:
    """Record the median time, and that of a bare container of the same image that imports rclpy."""
    bare, ready = [], []
    async with contained.robot("r5") as robot:
        for turn in range(5):
            begin = time.monotonic()
            await asyncio.to_thread(run_bare, images)
            bare.append(time.monotonic() - begin)
            begin = time.monotonic()
            async with robot.environment(f"timed{turn}"):
                ready.append(time.monotonic() - begin)
    figures = {"bare": statistics.median(bare), "ready": statistics.median(ready)}
    record_property("seconds", figures)
    print(figures)


def run_bare(api: Any) -> None:
    config = api.create_host_config(network_mode="none")
    command = ["python3", "-c", "import rclpy; rclpy.init()"]
    made = api.create_container(f"{MAPPING}:{__version__}", command, host_config=config)
    api.start(made["Id"])
    assert api.wait(made["Id"])["StatusCode"] == 0
    api.remove_container(made["Id"])
