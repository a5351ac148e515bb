"""The endpoint as a process: joining the Master, being refused, and ending with its nodes."""

from __future__ import annotations

import asyncio
import secrets
import signal
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from twisted.internet.base import ReactorBase

from endpoints.data.frames import Message
from rce.control.calls.endpoints import NodeSpec, StartNode
from rce.errors import NotConnected
from tests.support.endpoints.environment_driver import LIMIT, NAME, FakeMaster, driven, is_alive, wait_for_line

REQUEST = b"\0\1\0\0\1\0\0\0"  # SetBool, serialized


async def start_node(master: FakeMaster) -> int:
    """Start a node; return its pid."""
    await master.call(StartNode(NodeSpec("living", "probe", "say", "live")))
    return int((await wait_for_line(master, "living", "pids")).split()[1])


async def process_ended(pid: int) -> None:
    async with asyncio.timeout(LIMIT):
        while is_alive(pid):  # noqa: ASYNC110
            await asyncio.sleep(0.01)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
async def test_nodes_end_with_endpoint(reactor: ReactorBase, tmp_path: Path, number: signal.Signals) -> None:
    async with driven(reactor, tmp_path) as (master, process):
        pid = await start_node(master)
        process.send_signal(number)
        status = await asyncio.wait_for(process.wait(), LIMIT)
        await process_ended(pid)
        assert status == (0 if number != signal.SIGKILL else -signal.SIGKILL)


async def test_endpoint_joins_with_token_and_rejoins_with_credential(reactor: ReactorBase, tmp_path: Path) -> None:
    async with driven(reactor, tmp_path) as (master, _):
        assert (master.hello.role, master.hello.name, master.hello.token) == ("environment", NAME, "token")
        assert master.hello.addresses == []  # the Master knows the way to it from the task set
        pid = await start_node(master)
        (await master.joined).close()
        async with asyncio.timeout(LIMIT):
            while master.hello.token == "token":  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        assert master.hello.token == "credential"
        assert is_alive(pid)


async def test_refused_endpoint_ends_with_its_nodes(reactor: ReactorBase, tmp_path: Path) -> None:
    async with driven(reactor, tmp_path) as (master, process):
        pid = await start_node(master)
        master.refuse = True
        (await master.joined).close()
        assert await asyncio.wait_for(process.wait(), LIMIT) == 1
        await process_ended(pid)


async def test_requests_that_come_while_it_stops_are_dropped_quietly(reactor: ReactorBase, tmp_path: Path) -> None:
    async with driven(reactor, tmp_path) as (master, process):
        robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "/nobody")
        ended = asyncio.create_task(process.wait())
        process.terminate()
        async with asyncio.timeout(LIMIT):
            while not ended.done():
                with suppress(NotConnected):
                    robot.request(Message(robot.id, secrets.token_hex(16), REQUEST))
                await asyncio.sleep(0.001)
        log = (tmp_path / "internal.log").read_text()
        assert "stopping on SIGTERM" in log
        assert "defect" not in log
