"""Nodes and their parameters, at a real endpoint."""

from __future__ import annotations

import asyncio
import errno
from pathlib import Path

import pytest

from tests.support.domains import domain

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.environment.nodes import Nodes
from endpoints.environment.packages import Packages
from endpoints.environment.parameters import Parameters
from endpoints.environment.prepared_node import ENCLAVE, Spare
from rce.control.calls.endpoints import (
    DropParameter,
    NodeSpec,
    ParameterSpec,
    PutParameter,
    StartNode,
    StopNode,
)
from rce.control.calls.watching import ReadLog
from rce.errors import InvalidRequest, NotFound, StartFailed
from tests.support.endpoints.environment_driver import FakeMaster, is_alive, wait_for_line


async def test_log_is_read_from_position(master: FakeMaster) -> None:
    await master.call(StartNode(NodeSpec("followed", "probe", "say", "live")))
    await wait_for_line(master, "followed", "pids")
    log = await master.call(ReadLog("followed"))
    assert log.lines
    assert (await master.call(ReadLog("followed", after=log.next, wait=0.01))).lines == []
    own = await master.call(ReadLog(""))
    assert any("node followed started: probe say" in each for each in own.lines)
    await master.call(StopNode("followed"))


async def test_node_that_ends_is_reported_with_status_and_last_lines(master: FakeMaster) -> None:
    await master.call(StartNode(NodeSpec("dying", "probe", "say", "die 'a b' $(env ROS_DOMAIN_ID)")))
    died = await master.died()
    assert (died.node, died.status) == ("dying", 3)
    assert died.lines[0] == f"arguments ['die', 'a b', '{domain('environment')}']"


async def test_node_of_user_sees_no_packages_or_secrets_of_rce(master: FakeMaster) -> None:
    await master.call(StartNode(NodeSpec("seeing", "probe", "say.py", "die")))
    died = await master.died()
    assert died.lines[1] == "sees ['rclpy']"
    assert died.lines[2].startswith("secrets ['RCE_RUN', 'RCE_KNOWLEDGE'] ")
    assert died.lines[2].endswith("/home")


@pytest.mark.parametrize("how", ["live", "deaf"])
async def test_stop_ends_whole_process_group(master: FakeMaster, how: str) -> None:
    await master.call(StartNode(NodeSpec(how, "probe", "say", how)))
    pids = [int(word) for word in (await wait_for_line(master, how, "pids")).split()[1:]]
    if how == "deaf":
        await wait_for_line(master, how, "deaf to")
    assert all(map(is_alive, pids))
    await master.call(StopNode(how))
    assert not any(map(is_alive, pids))
    await master.call(StopNode(how))


async def test_start_is_idempotent_and_changed_spec_restarts_node(master: FakeMaster) -> None:
    spec = NodeSpec("twice", "probe", "say", "live")
    await master.call(StartNode(spec))
    first = await wait_for_line(master, "twice", "pids")
    await master.call(StartNode(spec))
    assert await wait_for_line(master, "twice", "pids") == first
    await master.call(StartNode(NodeSpec("twice", "probe", "say", "live on")))
    assert "on" in await wait_for_line(master, "twice", "arguments ['live', 'on']")
    await master.call(StopNode("twice"))


@pytest.mark.parametrize(
    ("spec", "error"),
    [
        (NodeSpec("bad", "nothing", "say"), NotFound),
        (NodeSpec("bad", "probe", "nothing"), NotFound),
        (NodeSpec("bad", "probe", "say", "$(find nothing)"), NotFound),
        (NodeSpec("bad", "probe", "say", "'"), InvalidRequest),
        (NodeSpec("bad", "probe", "broken.sh"), StartFailed),
    ],
)
async def test_node_that_cannot_start_is_rejected(master: FakeMaster, spec: NodeSpec, error: type[Exception]) -> None:
    with pytest.raises(error):
        await master.call(StartNode(spec))


async def test_node_that_a_full_disk_refuses_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def fail(self: Nodes, spec: NodeSpec) -> None:
        raise OSError(errno.ENOSPC, "no space", "output.log")

    monkeypatch.setattr(Nodes, "_start", fail)
    nodes = Nodes(tmp_path, Packages([], []), Parameters(), {}, lambda died: None)
    with pytest.raises(StartFailed, match=r"node late did not start: disk full \(output.log: no space"):
        await nodes.start(NodeSpec("late", "probe", "say"))


async def test_first_node_that_comes_with_rce_takes_the_waiting_process(tmp_path: Path) -> None:
    pipe = asyncio.subprocess.PIPE
    spare = Spare(
        await asyncio.create_subprocess_exec("sleep", "1000", stdin=pipe, stdout=pipe, start_new_session=True)
    )
    (tmp_path / "home").mkdir()
    nodes = Nodes(tmp_path, Packages([], []), Parameters(), {}, lambda died: None, spare)
    for tag in ("first", "second"):
        await nodes.start(NodeSpec(tag, "rce_demo", "echo"))
    assert (nodes.enclave("first"), nodes.enclave("second")) == (ENCLAVE, "/second")
    await nodes.stop_all()
    assert nodes.enclave("first") == "/first"


async def test_log_of_unknown_node_is_not_found(master: FakeMaster) -> None:
    with pytest.raises(NotFound):
        await master.call(ReadLog("never"))
    await master.call(StartNode(NodeSpec("talker", "probe", "say")))
    with pytest.raises(NotFound, match=r"did you mean talker\?"):
        await master.call(ReadLog("talkr"))


async def test_parameters_set_before_start(master: FakeMaster) -> None:
    await master.call(PutParameter(ParameterSpec("speed", 2.5, "fast")))
    await master.call(PutParameter(ParameterSpec("words", ["yes", "1"])))
    await master.call(StartNode(NodeSpec("fast", "probe", "echo", namespace="/fast", name="renamed")))
    assert "speed is 2.5" in await wait_for_line(master, "fast", "speed is")
    assert "['yes', '1']" in await wait_for_line(master, "fast", "words is")
    assert "renamed" in await wait_for_line(master, "fast", "speed is")
    await master.call(StopNode("fast"))
    await master.call(DropParameter(ParameterSpec("speed", 2.5, "fast").key))
    await master.call(DropParameter(ParameterSpec("words", [""]).key))
    await master.call(StartNode(NodeSpec("fast", "probe", "echo", namespace="/fast")))
    assert "speed is 1.0" in await wait_for_line(master, "fast", "speed is 1.0")
    await master.call(StopNode("fast"))
