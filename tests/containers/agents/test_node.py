"""Sockets of environments that an agent serves, with a task set in memory."""

from __future__ import annotations

import os
import socket
from pathlib import Path

from twisted.internet.base import ReactorBase

from containers.agents.node import NodeServices, NodeSettings
from containers.control_relay import SOCKET
from containers.data_relay import GATE
from containers.data_socket import OFFER
from rce.control.calls.environments import SetRelays

RUN, NEXT = "1" * 32, "2" * 32


def services(reactor: ReactorBase) -> NodeServices:
    settings = NodeSettings(master="tcp:127.0.0.1:1", task_set="tcp:127.0.0.1:1", token="secret", node="n1")
    return NodeServices(reactor, settings, lambda: None, list)


def listens(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as client:
        return client.connect_ex(str(path)) == 0


async def test_served_environment_finds_its_three_sockets(reactor: ReactorBase, tmp_path: Path) -> None:
    node = services(reactor)
    await node.listen("127.0.0.1")
    assert node.relay.startswith("127.0.0.1:")
    await node.serve("ann/map", RUN, tmp_path, tmp_path / "links.sock")
    assert node.served == {RUN}
    assert set(os.listdir(tmp_path)) == {SOCKET, GATE, OFFER}
    assert listens(tmp_path / SOCKET)
    node.stop_serving(RUN)
    assert node.served == set()
    assert not listens(tmp_path / SOCKET)
    node.stop_serving(RUN)
    await node.close()


async def test_end_of_an_old_run_leaves_the_gate_of_the_new_one(reactor: ReactorBase, tmp_path: Path) -> None:
    node, old, new = services(reactor), tmp_path / "old", tmp_path / "new"
    for run, directory in ((RUN, old), (NEXT, new)):
        directory.mkdir()
        await node.serve("ann/map", run, directory, tmp_path / f"{run}.sock")
    node.stop_serving(RUN)
    assert listens(new / GATE)
    node.stop_serving(NEXT)
    assert not listens(new / GATE)
    await node.close()


async def test_call_to_an_absent_task_set_is_not_an_error(reactor: ReactorBase) -> None:
    await services(reactor).notify(SetRelays([]))
