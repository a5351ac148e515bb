# ruff: noqa: E402  (imports after importorskip)
"""Containers on a Docker daemon, whose API is a stand-in: what is read from its answers, and its errors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from docker.errors import APIError, ImageNotFound, NotFound

from containers.docker import daemon as module
from containers.docker.daemon import Daemon, Found, State, describe
from containers.docker.networks import Attachments
from containers.docker.options import ContainerOptions
from rce import __version__
from rce.errors import StartFailed, Unavailable
from rce.protocol.slots import MB

LABELS = {"rce.platform": "machine"}
FOUND = Found("id", "ann/map", "1" * 32, 1, running=True)
OPTIONS = ContainerOptions("10000:10000", {}, Attachments(hostname="h" * 80))
LISTED: dict[str, Any] = {
    "Id": "id",
    "State": "running",
    "Labels": {**LABELS, "rce.environment": "ann/map", "rce.run": "1" * 32, "rce.size": "2", "rce.gpus": "0,3"},
}


def refusal(status: int, reason: str) -> APIError:
    return APIError(reason, SimpleNamespace(status_code=status, url="", reason=reason), reason)


class Api:
    """Docker's API with one container; `errors` are raised by the calls of these names."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.created: dict[str, Any] = {}
        self.errors: dict[str, Exception] = {}
        self.listed: list[dict[str, Any]] = [LISTED]
        self.states: list[dict[str, Any]] = []
        self.image_labels: dict[str, str] | None = {"rce.version": __version__}

    def _called(self, name: str) -> None:
        self.calls.append(name)
        if name in self.errors:
            raise self.errors[name]

    def containers(self, **_: Any) -> list[dict[str, Any]]:
        self._called("containers")
        return self.listed

    def inspect_container(self, container: str) -> dict[str, Any]:
        self._called("inspect")
        state = self.states.pop(0) if len(self.states) > 1 else self.states[0]
        return {"State": {"Running": False, **state}, "HostConfig": {"Memory": 32 * MB}}

    def inspect_image(self, image: str) -> dict[str, Any]:
        self._called("inspect_image")
        return {"Config": {"Labels": self.image_labels}}

    def create_host_config(self, **options: Any) -> dict[str, Any]:
        return options

    def create_container(self, image: str, command: list[str], **options: Any) -> dict[str, str]:
        self._called("create")
        self.created = options
        return {"Id": "id"}

    def start(self, container: str) -> None:
        self._called("start")

    def stop(self, container: str, timeout: float) -> None:
        self._called("stop")

    def remove_container(self, container: str, **_: Any) -> None:
        self._called("remove")

    def logs(self, container: str, tail: int) -> bytes:
        self._called("logs")
        return b"one\ntwo \xff\n"

    def stats(self, container: str, **_: Any) -> dict[str, Any]:
        self._called("stats")
        return {"cpu_stats": {"cpu_usage": {"total_usage": 1e9}}, "memory_stats": {"usage": 7}}

    def info(self) -> dict[str, Any]:
        return {"DockerRootDir": "/nonexistent", "CgroupVersion": "2"}


@pytest.fixture
def api() -> Api:
    return Api()


@pytest.fixture
def daemon(api: Api, monkeypatch: pytest.MonkeyPatch) -> Daemon:
    monkeypatch.setattr(module, "STATE_INTERVAL", 0)
    daemon = Daemon(LABELS)
    daemon._api = api
    return daemon


async def test_containers_are_read_from_their_labels(daemon: Daemon, api: Api) -> None:
    labels = {key: value for key, value in LISTED["Labels"].items() if key != "rce.gpus"}
    dead = {**LISTED, "State": "exited", "Labels": labels}
    api.listed = [LISTED, dead]
    assert await daemon.present() == [
        Found("id", "ann/map", "1" * 32, 2, running=True, gpus=["0", "3"]),
        Found("id", "ann/map", "1" * 32, 2, running=False),
    ]


# --- starting ---------------------------------------------------------------------------------------------------------


async def start(daemon: Daemon, found: Found = FOUND) -> None:
    await daemon.start(found, "image", ["program"], {}, OPTIONS)


async def test_container_has_the_labels_by_which_it_is_found(daemon: Daemon, api: Api) -> None:
    await start(daemon, Found("", "ann/map", "1" * 32, 2, running=False, gpus=["0", "3"]))
    assert api.created["labels"] == LISTED["Labels"]
    assert api.created["name"] == f"rce-{'1' * 32}"
    assert api.calls[-2:] == ["create", "start"]


async def test_host_name_is_not_longer_than_allowed(daemon: Daemon, api: Api) -> None:
    await start(daemon)
    assert api.created["hostname"] == "h" * 63


async def test_missing_image_is_explained(daemon: Daemon, api: Api) -> None:
    api.errors["inspect_image"] = ImageNotFound("no such image")
    with pytest.raises(StartFailed, match=r"ann/map did not start: this machine has no image image; .*provision image"):
        await start(daemon)


@pytest.mark.parametrize(
    ("labels", "fault"), [(None, "has no label rce.version"), ({"rce.version": "0.0.1"}, "was built for RCE 0.0.1")]
)
async def test_image_of_another_version_is_not_started(
    daemon: Daemon, api: Api, labels: dict[str, str] | None, fault: str
) -> None:
    api.image_labels = labels
    with pytest.raises(StartFailed, match=fault):
        await start(daemon)
    assert "create" not in api.calls


async def test_refused_start_has_the_reason_of_docker(daemon: Daemon, api: Api) -> None:
    api.errors["start"] = refusal(500, "no space left on device")
    with pytest.raises(StartFailed, match="ann/map did not start: no space left on device"):
        await start(daemon)


# --- removal ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [NotFound("gone"), refusal(409, "removal is already in progress")])
@pytest.mark.parametrize("call", ["stop", "remove"])
async def test_container_that_is_removed_meanwhile_is_no_error(
    daemon: Daemon, api: Api, call: str, error: Exception
) -> None:
    api.errors[call] = error
    await daemon.remove("ann/map")
    assert call in api.calls


async def test_failed_removal_is_reported(daemon: Daemon, api: Api) -> None:
    api.errors["remove"] = refusal(500, "device is busy")
    with pytest.raises(Unavailable, match="device is busy"):
        await daemon.remove("ann/map")


# --- ends -------------------------------------------------------------------------------------------------------------


async def test_state_after_a_kill_waits_for_its_reason(daemon: Daemon, api: Api) -> None:
    """Docker learns a moment later that the container was out of memory."""
    killed = {"ExitCode": 137, "OOMKilled": False}
    api.states = [killed, killed, {**killed, "OOMKilled": True}]
    assert await daemon.state("1" * 32) == State(137, out_of_memory=True, memory=32 * MB)


async def test_kill_for_another_reason_is_reported_after_a_while(daemon: Daemon, api: Api) -> None:
    api.states = [{"ExitCode": 137, "OOMKilled": False}]
    assert await daemon.state("1" * 32) == State(137, out_of_memory=False, memory=32 * MB)
    assert api.calls.count("inspect") == module.STATE_TRIES


async def test_state_of_a_running_container(daemon: Daemon, api: Api) -> None:
    api.states = [{"ExitCode": 0, "OOMKilled": False, "Running": True}]
    state = await daemon.state("1" * 32)
    assert state is not None
    assert state.running
    assert api.calls.count("inspect") == 1


async def test_container_that_does_not_exist_has_no_state_and_no_output(daemon: Daemon, api: Api) -> None:
    api.listed = []
    assert await daemon.state("1" * 32) is None
    assert await daemon.last_lines("1" * 32, 20) == []


async def test_output_that_is_not_utf8_is_readable(daemon: Daemon) -> None:
    assert await daemon.last_lines("1" * 32, 20) == ["one", "two \ufffd"]


@pytest.mark.parametrize(
    ("state", "status", "reason"),
    [
        (State(3, False, 0), 3, "ended with status 3"),
        (State(137, False, 0), -9, "was killed by signal 9 (Killed)"),
        (State(137, True, 32 * MB), -9, "was killed by signal 9 (Killed); it exceeded its memory of 32 MB"),
        (State(137, False, 32 * MB), -9, "was killed by signal 9 (Killed); it may have exceeded its memory of 32 MB"),
        (State(143, False, 32 * MB), -15, "was killed by signal 15 (Terminated)"),
        (State(128, False, 0), 128, "ended with status 128"),
    ],
)
def test_end_is_described(state: State, status: int, reason: str) -> None:
    assert describe(state) == (status, reason)


# --- measurements -----------------------------------------------------------------------------------------------------


async def test_container_that_ends_meanwhile_has_no_usage(daemon: Daemon, api: Api) -> None:
    assert {name: used.memory for name, used in (await daemon.usage()).items()} == {"ann/map": 7}
    api.errors["stats"] = NotFound("gone")
    assert await daemon.usage() == {}


async def test_images_on_another_machine_have_no_device(daemon: Daemon) -> None:
    machine = await daemon.machine()
    assert (machine.image_device, machine.limits_buffered_writes) == ("", True)
