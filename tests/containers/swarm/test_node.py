"""Access of an agent to its node's Docker, whose API is a stand-in."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from docker.errors import APIError, NotFound

from containers.agents.outside_limits import LimitRequest
from containers.docker.api import DOCKER_SOCKET
from containers.swarm.node import NodeDaemon, Task
from containers.swarm.privileged import COMMAND
from rce.control.calls.agents import PullImage
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import InvalidRequest, StartFailed, Unavailable
from tests.support.containers.engine_contract import spec

LABELS = {"rce.platform": "machine"}
RUN = "1" * 32
PULL = PullImage("rce/base:1", "10.0.0.1:5000/rce@sha256:0", "agent", "secret")


def refusal(status: int, reason: str = "refused") -> APIError:
    return APIError(reason, SimpleNamespace(status_code=status, url="", reason=reason), reason)


class Api:
    """Docker's API of a node with one container, which is in the network `group`."""

    def __init__(self) -> None:
        self.listed: list[dict[str, Any]] = [{"Id": "id"}]
        self.networks = {"group": {"IPAddress": "10.128.0.200"}}
        self.changes: list[str] = []
        self.found: list[dict[str, Any]] = []
        self.volume_error: Exception | None = None
        self.progress: list[dict[str, str]] = [{"status": "Downloading"}]
        self.pull_error: Exception | None = None
        self.result: tuple[int, bytes] = (0, b"")
        self.made: dict[str, Any] = {}

    def containers(self, **_: Any) -> list[dict[str, Any]]:
        return self.listed

    def inspect_container(self, container: str) -> dict[str, Any]:
        mounts = [
            {"Target": "/usr", "Source": "/usr", "Type": "bind", "ReadOnly": True},
            {"Target": DOCKER_SOCKET, "Source": DOCKER_SOCKET, "Type": "bind"},
            {"Target": "/volume", "Source": "volume", "Type": "volume"},
        ]
        networks = {"Networks": self.networks}
        return {"Id": "id", "Image": "sha256:agent", "HostConfig": {"Mounts": mounts}, "NetworkSettings": networks}

    def connect_container_to_network(self, container: str, network: str, ipv4_address: str) -> None:
        self.changes.append(f"connect {network} as {ipv4_address}")

    def disconnect_container_from_network(self, container: str, network: str) -> None:
        self.changes.append(f"disconnect {network}")

    def images(self, **_: Any) -> list[dict[str, Any]]:
        return [{"Id": "sha256:1", "RepoTags": ["a:1", "b:1"]}, {"Id": "sha256:2", "RepoTags": None}]

    def volumes(self, **_: Any) -> dict[str, Any]:
        return {"Volumes": self.found or None}

    def remove_volume(self, name: str) -> None:
        if self.volume_error is not None:
            raise self.volume_error
        self.changes.append(f"remove {name}")

    def inspect_volume(self, name: str) -> dict[str, str]:
        return {"Mountpoint": f"/volumes/{name}"}

    def create_volume(self, name: str, labels: dict[str, str]) -> dict[str, str]:
        self.made = labels
        return {"Mountpoint": f"/volumes/{name}"}

    def pull(self, repository: str, digest: str, **_: Any) -> list[dict[str, str]]:
        if self.pull_error is not None:
            raise self.pull_error
        self.changes.append(f"pull {repository} {digest}")
        return self.progress

    def tag(self, source: str, name: str, tag: str) -> None:
        self.changes.append(f"tag {name} {tag}")

    def create_host_config(self, **options: Any) -> dict[str, Any]:
        return options

    def create_container(self, image: str, command: list[str], **options: Any) -> dict[str, str]:
        self.made = {"image": image, "command": command, **options}
        return {"Id": "limits"}

    def start(self, container: str) -> None:
        self.changes.append(f"start {container}")

    def wait(self, container: str) -> dict[str, int]:
        return {"StatusCode": self.result[0]}

    def logs(self, container: str) -> bytes:
        return self.result[1]

    def remove_container(self, container: str, force: bool) -> None:
        self.changes.append(f"remove {container}")


@pytest.fixture
def api() -> Api:
    return Api()


@pytest.fixture
def daemon(api: Api) -> NodeDaemon:
    daemon = NodeDaemon(LABELS)
    daemon._api = api
    return daemon


@pytest.mark.parametrize(
    ("state", "running", "ended"),
    [
        ("running", True, False),
        ("created", False, False),
        ("exited", False, True),
        ("dead", False, True),
        ("removing", False, False),
    ],
)
async def test_tasks_are_read_from_labels(daemon: NodeDaemon, api: Api, state: str, running: bool, ended: bool) -> None:
    asked: EnvironmentSpec = spec()
    labels = {"rce.environment": "ann/map", "rce.run": RUN, "rce.spec": msgspec.json.encode(asked).decode()}
    api.listed = [{"Labels": labels, "State": state}]
    assert await daemon.tasks() == [Task("ann/map", RUN, running, ended, asked)]


async def test_images_are_found_by_every_tag(daemon: NodeDaemon) -> None:
    assert await daemon.images() == {"a:1": "sha256:1", "b:1": "sha256:1"}


# --- networks ---------------------------------------------------------------------------------------------------------


async def test_address_that_swarm_chose_is_replaced(daemon: NodeDaemon, api: Api) -> None:
    await daemon.set_group_address(RUN, "group", "10.128.0.7")
    assert api.changes == ["disconnect group", "connect group as 10.128.0.7"]


async def test_address_that_is_right_stays(daemon: NodeDaemon, api: Api) -> None:
    await daemon.set_group_address(RUN, "group", "10.128.0.200")
    assert api.changes == []


async def test_interrupted_change_of_an_address_is_completed(daemon: NodeDaemon, api: Api) -> None:
    """The agent ended after it had disconnected the container."""
    api.networks = {}
    await daemon.set_group_address(RUN, "group", "10.128.0.7")
    assert api.changes == ["connect group as 10.128.0.7"]


async def test_network_is_joined_once(daemon: NodeDaemon, api: Api) -> None:
    await daemon.join_network(RUN, "group", "10.128.0.7")
    assert api.changes == []
    await daemon.join_network(RUN, "egress", "10.127.0.2")
    assert api.changes == ["connect egress as 10.127.0.2"]


# --- images -----------------------------------------------------------------------------------------------------------


async def test_pulled_image_gets_its_tag(daemon: NodeDaemon, api: Api) -> None:
    await daemon.pull(PULL)
    assert api.changes == ["pull 10.0.0.1:5000/rce sha256:0", "tag rce/base 1"]


async def test_error_during_a_pull_is_reported(daemon: NodeDaemon, api: Api) -> None:
    api.progress += [{"error": "unauthorized"}, {"status": "never seen"}]
    with pytest.raises(StartFailed, match="image rce/base:1 cannot be pulled: unauthorized"):
        await daemon.pull(PULL)
    assert not any(change.startswith("tag") for change in api.changes)


async def test_refused_pull_is_reported(daemon: NodeDaemon, api: Api) -> None:
    api.pull_error = refusal(500, "server gave HTTP response to HTTPS client")
    with pytest.raises(StartFailed, match="rce/base:1 cannot be pulled: server gave HTTP response"):
        await daemon.pull(PULL)


# --- volumes ----------------------------------------------------------------------------------------------------------


async def test_volumes_of_other_runs_are_removed(daemon: NodeDaemon, api: Api) -> None:
    api.found = [
        {"Name": "kept", "Labels": {"rce.run": RUN}},
        {"Name": "old", "Labels": {"rce.run": "2" * 32}},
        {"Name": "of a user", "Labels": {}},
    ]
    await daemon.sweep({RUN})
    assert api.changes == ["remove old", "remove of a user"]


async def test_node_without_volumes_is_swept(daemon: NodeDaemon, api: Api) -> None:
    await daemon.sweep(set())
    assert api.changes == []


@pytest.mark.parametrize("error", [NotFound("gone"), refusal(409, "volume is in use")])
async def test_volume_in_use_or_gone_is_no_error(daemon: NodeDaemon, api: Api, error: Exception) -> None:
    api.found, api.volume_error = [{"Name": "old", "Labels": {}}], error
    await daemon.sweep(set())


async def test_volume_that_cannot_be_removed_is_an_error(daemon: NodeDaemon, api: Api) -> None:
    api.found, api.volume_error = [{"Name": "old", "Labels": {}}], refusal(500, "input/output error")
    with pytest.raises(Unavailable, match="input/output error"):
        await daemon.sweep(set())


async def test_new_volume_belongs_to_its_environment(daemon: NodeDaemon, api: Api) -> None:
    path = await daemon.make_volume("disk", Task("ann/map", RUN, True, False, spec()))
    assert path == Path("/volumes/disk")
    assert api.made == {**LABELS, "rce.environment": "ann/map", "rce.run": RUN}


# --- limits -----------------------------------------------------------------------------------------------------------

LIMITS = LimitRequest(7, "/images", bandwidth=5)


async def test_limits_are_applied_by_a_program_of_the_agents_image(daemon: NodeDaemon, api: Api) -> None:
    """It sees the agent's directories, and not Docker's socket."""
    await daemon.apply_limits(LIMITS)
    assert (api.made["image"], api.made["command"]) == ("sha256:agent", COMMAND)
    assert msgspec.json.decode(api.made["environment"]["RCE_LIMITS"], type=LimitRequest) == LIMITS
    assert api.made["host_config"]["mem_limit"]
    assert api.made["host_config"]["pids_limit"]
    mounts = {mount["Target"]: mount["ReadOnly"] for mount in api.made["host_config"]["mounts"]}
    assert mounts == {"/usr": True, "/dev": False, "/sys/fs/cgroup": False}
    assert api.changes == ["start limits", "remove limits"]


async def test_refused_limit_keeps_its_error(daemon: NodeDaemon, api: Api) -> None:
    error = InvalidRequest("no tc here", field="containerData.bandwidth")
    api.result = (1, b"a warning\n" + msgspec.json.encode(error.info) + b"\n")
    with pytest.raises(InvalidRequest, match="no tc here") as raised:
        await daemon.apply_limits(LIMITS)
    assert raised.value.field == "containerData.bandwidth"


@pytest.mark.parametrize(
    ("output", "reason"), [(b"", "exit status 127 without output"), (b"python3: not found\n", "python3: not found")]
)
async def test_failed_program_is_explained(daemon: NodeDaemon, api: Api, output: bytes, reason: str) -> None:
    api.result = (127, output)
    with pytest.raises(StartFailed, match=f"its limits cannot be applied: {reason}"):
        await daemon.apply_limits(LIMITS)
    assert api.changes[-1] == "remove limits"
