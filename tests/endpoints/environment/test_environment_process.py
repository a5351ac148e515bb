"""The endpoint as a process: joining, being refused, ending with all its nodes."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from environment_driver import NAME, FakeMaster, driven
from test_environment_nodes import alive, line
from twisted.internet.base import ReactorBase

from rce.calls.endpoints import NodeSpec, StartNode


async def node(master: FakeMaster) -> int:
    """A node's pid."""
    await master.call(StartNode(NodeSpec("living", "probe", "say", "live")))
    return int((await line(master, "living", "pids")).split()[1])


async def gone(pid: int) -> None:
    async with asyncio.timeout(10):
        while alive(pid):  # noqa: ASYNC110
            await asyncio.sleep(0.01)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
async def test_its_nodes_end_with_it(reactor: ReactorBase, tmp_path: Path, number: signal.Signals) -> None:
    async with driven(reactor, tmp_path) as (master, process):
        pid = await node(master)
        process.send_signal(number)
        status = await asyncio.wait_for(process.wait(), 10)
        await gone(pid)
        assert status == (0 if number != signal.SIGKILL else -signal.SIGKILL)


async def test_it_joins_with_its_name_and_addresses_and_rejoins_with_its_credential(
    reactor: ReactorBase, tmp_path: Path
) -> None:
    async with driven(reactor, tmp_path, listen="127.0.0.1") as (master, _):
        assert (master.hello.role, master.hello.name, master.hello.token) == ("environment", NAME, "token")
        assert [address.partition(":")[0] for address in master.hello.addresses] == ["unix", "tcp"]
        pid = await node(master)
        (await master.joined).close()
        async with asyncio.timeout(10):
            while master.hello.token == "token":  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        assert master.hello.token == "credential"
        assert alive(pid)


async def test_refused_it_ends_with_its_nodes(reactor: ReactorBase, tmp_path: Path) -> None:
    async with driven(reactor, tmp_path) as (master, process):
        pid = await node(master)
        master.refuse = True
        (await master.joined).close()
        assert await asyncio.wait_for(process.wait(), 10) == 1
        await gone(pid)
