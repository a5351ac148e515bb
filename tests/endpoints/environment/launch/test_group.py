"""The nodes of a launch file that run, at a real endpoint."""

from __future__ import annotations

import os
import signal

import pytest

from rce.control.calls.endpoints import Launched, NodeDied, NodeSpec, StartNode, StopNode
from rce.control.calls.watching import ReadLog
from rce.errors import InvalidRequest, NotFound
from tests.support.endpoints.environment_driver import FakeMaster, is_alive, wait_for_line


def launch(tag: str, file: str, args: str = "") -> StartNode:
    return StartNode(NodeSpec(tag, "probe", "", args, launch=file))


async def pid(master: FakeMaster, tag: str) -> int:
    return int((await wait_for_line(master, tag, "pids")).split()[1])


async def died(master: FakeMaster, tag: str) -> NodeDied:
    """Return the next end of a node."""
    while (found := await master.died()).node != tag:
        pass
    return found


async def test_nodes_of_launch_are_reported_and_end_together(master: FakeMaster) -> None:
    await master.call(launch("both", "two.launch.py"))
    reported = await master.launched()
    assert [node.tag for node in reported.nodes] == ["both.one", "both.deep.two"]
    assert reported.nodes[1] == NodeSpec("both.deep.two", "probe", "say", "live", "two", "deep")
    pids = [await pid(master, node.tag) for node in reported.nodes]
    assert all(map(is_alive, pids))
    lines = (await master.call(ReadLog("both"))).lines
    assert lines[0] == "it is live"
    assert "both.one started: probe say" in lines
    await master.call(StopNode("both"))
    assert not any(map(is_alive, pids))


async def test_start_is_idempotent_and_reports_again(master: FakeMaster) -> None:
    call = launch("again", "two.launch.py")
    await master.call(call)
    first = await master.launched()
    process = await pid(master, "again.one")
    await master.call(call)
    assert await master.launched() == first
    assert await pid(master, "again.one") == process
    await master.call(StopNode("again"))


async def test_parameters_of_launch_file_reach_the_node(master: FakeMaster) -> None:
    await master.call(launch("slow", "echo.launch.xml", "speed:=0.5"))
    assert "renamed" in await wait_for_line(master, "slow.renamed", "speed is 0.5")
    await wait_for_line(master, "slow.renamed", "words is ['yes', '1']")
    await master.call(StopNode("slow"))


async def test_ends_of_nodes_are_reported_and_then_that_of_launch(master: FakeMaster) -> None:
    await master.call(launch("alone", "ends.launch.yaml", "only:=true"))
    end = await died(master, "alone.die")
    assert (end.status, end.again) == (3, False)
    assert end.lines[0] == "arguments ['die']"
    over = await died(master, "alone")
    assert over.status == 3
    assert over.lines[-1] == "alone.die ended with status 3"


async def test_launch_goes_on_without_a_node_that_ended(master: FakeMaster) -> None:
    await master.call(launch("fewer", "two.launch.py", "how:=die"))
    await died(master, "fewer.one")
    assert is_alive(await pid(master, "fewer.deep.two"))
    await master.call(StopNode("fewer"))


async def test_required_node_ends_the_launch(master: FakeMaster) -> None:
    await master.call(launch("needing", "ends.launch.yaml", "required:=true"))
    living = await pid(master, "needing.live")
    os.kill(await pid(master, "needing.needed"), signal.SIGKILL)
    assert (await died(master, "needing")).status == -signal.SIGKILL
    assert not is_alive(living)


async def test_node_is_started_again_if_the_file_says_so(master: FakeMaster) -> None:
    await master.call(launch("steady", "ends.launch.yaml", "respawn:=true"))
    for _ in range(2):
        assert (await died(master, "steady.die")).again
    await master.call(StopNode("steady"))


async def test_launch_whose_node_does_not_start_is_refused(master: FakeMaster) -> None:
    while not master.reports.empty():
        master.reports.get_nowait()
    with pytest.raises(NotFound, match="package probe has no executable nothing"):
        await master.call(launch("bad", "bad.launch.xml"))
    await master.launched()
    assert await master.launched() == Launched("bad", [])


@pytest.mark.parametrize(
    ("file", "args", "error", "message"),
    [
        ("two", "", NotFound, "has no launch file two: it has|did you mean"),
        ("../../other.py", "", NotFound, "has no launch file"),
        ("two.launch.py", "how=live", InvalidRequest, "write NAME:=VALUE"),
        ("two.launch.py", "what:=live", InvalidRequest, "no argument what; it has how"),
    ],
)
async def test_wrong_launch_is_refused(
    master: FakeMaster, file: str, args: str, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        await master.call(launch("wrong", file, args))
