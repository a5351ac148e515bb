"""Ports by which the agents of a swarm reach their task set, without a swarm."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any, cast

import pytest
from twisted.internet.base import ReactorBase

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.agents.connections import AgentAccess
from containers.swarm.fleet import Fleet
from containers.swarm.spec import AgentService
from rce.errors import Unavailable

LABELS = {"rce.platform": "machine", "rce.directory": "/var/lib/rce"}
HOST = "127.0.0.1"


class FakeManager:
    """Manager of a swarm without nodes, which records the tasks of the agents' service."""

    address = HOST
    root = "/var/lib/docker"

    def __init__(self) -> None:
        self.tasks: list[dict[str, Any]] = []

    async def image_id(self, tag: str) -> str:
        return "sha256:0"

    async def sweep_exports(self, directory: Path) -> None: ...

    async def update_agent_service(self, name: str, task: dict[str, Any]) -> None:
        self.tasks.append(task)


async def open_and_close(reactor: ReactorBase, file: Path, manager: FakeManager, address: str = HOST) -> AgentAccess:
    """Return what the next task set knows after a fleet was opened and closed."""
    fleet = Fleet(cast(Any, manager), LABELS, (), file, AgentService("rce/agent", address), None)
    try:
        await fleet.open(reactor, f"tcp:{HOST}:1", lambda node: None, lambda handlers: None)
        return AgentAccess.load(file)
    finally:
        await fleet.close()


async def test_ports_stay_the_same(reactor: ReactorBase, tmp_path: Path) -> None:
    manager = FakeManager()
    first = await open_and_close(reactor, tmp_path / "swarm.json", manager)
    assert first.port
    assert first.images
    assert await open_and_close(reactor, tmp_path / "swarm.json", manager) == first
    assert manager.tasks[0] == manager.tasks[1], "the agents need not be restarted"


async def test_ports_in_use_are_replaced_and_agents_get_the_new_address(reactor: ReactorBase, tmp_path: Path) -> None:
    file, manager = tmp_path / "swarm.json", FakeManager()
    with socket.create_server((HOST, 0)) as one, socket.create_server((HOST, 0)) as other:
        in_use = AgentAccess("secret", one.getsockname()[1], other.getsockname()[1])
        in_use.store(file)
        access = await open_and_close(reactor, file, manager)
    assert access.secret == "secret"
    assert not {access.port, access.images} & {0, in_use.port, in_use.images}
    assert f"RCE_TASK_SET=tcp:{HOST}:{access.port}" in manager.tasks[-1]["ContainerSpec"]["Env"]


async def test_address_of_another_machine_is_unavailable(reactor: ReactorBase, tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match=r"cannot listen for the agents of the swarm at 192\.0\.2\.1"):
        await open_and_close(reactor, tmp_path / "swarm.json", FakeManager(), "192.0.2.1")
