"""Calls of the Master about a whole environment, and what the endpoint reports by itself."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.data.frames import Message
from endpoints.data.link import Link
from endpoints.data.port import DataPort
from endpoints.environment.endpoint import Environment
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.live_parameters import LiveParameters
from endpoints.environment.node import NodeProcess
from endpoints.environment.output_log import OutputLog
from endpoints.environment.settings import Settings
from rce.control.calls.call import Call
from rce.control.calls.endpoints import (
    Bind,
    DropParameter,
    InterfaceSpec,
    LinkSpec,
    NodeSpec,
    ParameterSpec,
    PutParameter,
    Report,
    StartNode,
    Sync,
    Unbind,
)
from rce.control.calls.robots import DescribeType
from rce.control.calls.watching import ReadGraph, ReadLog, ReadPackages, RosName
from rce.errors import InvalidRequest, RceError
from tests.support.control import answer
from tests.support.endpoints.environment_driver import FakeMaster, is_alive, wait_for_line
from tests.support.endpoints.fake_ros import InstantRos

SPEC = InterfaceSpec("0a" * 16, "ann/env", "tag", "PublisherInterface", "std_msgs/String", "there")


class Quiet(RosInterface):
    """Interface without ROS."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.ticks: list[float] = []

    async def open(self) -> None: ...

    def receive(self, message: Message, link: Link) -> None: ...

    def tick(self, now: float) -> None:
        self.ticks.append(now)


class FakeLiveParameters:
    """Parameters of running nodes, which refuse values as the test says."""

    def __init__(self) -> None:
        self.set: list[ParameterSpec] = []
        self.refuses = False

    async def put(self, spec: ParameterSpec, starting: set[str]) -> None:
        self.set.append(spec)
        if self.refuses:
            raise InvalidRequest("too fast")


class Trial:
    """An environment without ROS, with the calls that it sends to the Master."""

    def __init__(self, directory: Path) -> None:
        settings = Settings("ann/env", "0" * 32, "token", "tcp:127.0.0.1:1", directory)
        self.reports: list[Call[Any]] = []
        self.log = OutputLog(directory / "environment.log")
        self.environment = Environment(
            settings, cast(Any, InstantRos()), DataPort(), self.reports.append, self.log, self.log
        )
        self.parameters = FakeLiveParameters()
        self.environment._live_parameters = cast(LiveParameters, self.parameters)
        self.handlers = self.environment.handlers()

    async def call(self, call: Call[Any]) -> Any:
        """Answer a call of the Master; return its result, or the error of a call that fails."""
        try:
            return await answer(self.handlers, call)
        except RceError as error:
            return error.info

    def run_a_node(self) -> None:
        """Let the environment believe that a node runs."""
        node = SimpleNamespace(spec=NodeSpec("brain", "p", "e"), started=-math.inf)
        self.environment._nodes._running["brain"] = cast(NodeProcess, node)


@pytest.fixture
def trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Trial]:
    monkeypatch.setattr("endpoints.environment.endpoint.KINDS", {"PublisherInterface": Quiet})
    made = Trial(tmp_path)
    yield made
    made.log.close()


def interface(trial: Trial) -> Quiet:
    (found,) = trial.environment._switchboard.interfaces.values()
    assert isinstance(found, Quiet)
    return found


async def test_unknown_kind_of_interface_is_rejected(trial: Trial) -> None:
    error = await trial.call(Bind(msgspec.structs.replace(SPEC, kind="PublisherConverter")))
    assert (error.code, error.field) == ("invalid_request", "interfaceType")
    assert "PublisherInterface" in error.message


async def test_dropped_messages_are_reported_when_there_are_more(trial: Trial) -> None:
    await trial.call(Bind(SPEC))
    trial.environment._tick(1.0)
    assert trial.reports == []
    interface(trial).dropped = 3
    for now in (2.0, 3.0):
        trial.environment._tick(now)
    interface(trial).dropped = 5
    trial.environment._tick(4.0)
    assert trial.reports == [Report("ann/env", "tag", drops=3), Report("ann/env", "tag", drops=5)]
    assert interface(trial).ticks == [1.0, 2.0, 3.0, 4.0]


async def test_drops_of_new_interface_are_counted_anew(trial: Trial) -> None:
    for _ in range(2):
        await trial.call(Bind(SPEC))
        interface(trial).dropped = 3
        trial.environment._tick(1.0)
        await trial.call(Unbind(SPEC.id))
        trial.environment._tick(2.0)
    assert [report.drops for report in trial.reports if isinstance(report, Report)] == [3, 3]


async def test_error_of_interface_is_reported_to_its_owner(trial: Trial) -> None:
    await trial.call(Bind(SPEC))
    error = InvalidRequest("not for this interface")
    interface(trial)._report_once(error)
    assert trial.reports == [Report("ann/env", "tag", error.info)]


async def test_parameter_is_set_for_running_nodes_once(trial: Trial) -> None:
    await trial.call(PutParameter(ParameterSpec("early", 1)))
    assert trial.parameters.set == [], "no node runs"
    trial.run_a_node()
    for value in (1, 2, 2):
        await trial.call(PutParameter(ParameterSpec("speed", value)))
    assert [spec.value for spec in trial.parameters.set] == [1, 2]


async def test_refused_parameter_keeps_its_former_value(trial: Trial) -> None:
    trial.run_a_node()
    await trial.call(PutParameter(ParameterSpec("speed", 1)))
    trial.parameters.refuses = True
    for name in ("speed", "new"):
        assert (await trial.call(PutParameter(ParameterSpec(name, 11)))).message == "too fast"
    assert trial.environment._parameters.of("brain") == {"speed": 1}
    await trial.call(DropParameter(ParameterSpec("speed", 1).key))
    assert trial.environment._parameters.of("brain") == {}


async def test_own_log_can_be_read_and_followed(trial: Trial) -> None:
    trial.log.write(b"one\ntwo\n")
    first = await trial.call(ReadLog("", lines=1))
    assert first.lines == ["two"]
    follower = asyncio.ensure_future(trial.call(ReadLog("", after=first.next, wait=10)))
    await asyncio.sleep(0)
    assert not follower.done()
    trial.log.write(b"three\n")
    assert (await follower).lines == ["three"]


async def test_running_nodes_are_counted(trial: Trial) -> None:
    trial.run_a_node()
    (family,) = trial.environment._families()
    assert [sample.value for sample in family.samples] == [1]


# --- at a real endpoint -----------------------------------------------------------------------------------------------


async def test_definition_of_type_is_read(master: FakeMaster) -> None:
    described = await master.call(DescribeType("user", "sensor_msgs/Image", "msg"))
    assert {"sensor_msgs/msg/Image", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"} == set(described.texts)


async def test_ros_graph_is_read(master: FakeMaster) -> None:
    await master.interface("SubscriberInterface", "std_msgs/String", "/read/here")
    await master.interface("ServiceProviderInterface", "std_srvs/SetBool", "/read/asked")
    graph = await master.call(ReadGraph())
    (topic,) = [each for each in graph.topics if each.name == "/read/here"]
    assert (topic.types, topic.publishers, topic.subscribers) == (["std_msgs/msg/String"], 0, 1)
    assert RosName("/read/asked", ["std_srvs/srv/SetBool"]) in graph.services


async def test_packages_with_executables_are_read(master: FakeMaster) -> None:
    found = {each.name: each.executables for each in (await master.call(ReadPackages())).packages}
    assert found["rce_demo"] == ["echo.py"]
    assert "echo.py" in found["probe"]


async def test_sync_reconciles_nodes_and_reports_failures(master: FakeMaster) -> None:
    await master.call(StartNode(NodeSpec("away", "probe", "say", "live")))
    pid = int((await wait_for_line(master, "away", "pids")).split()[1])
    echo = NodeSpec("echo", "probe", "echo.py")
    wanted = Sync(
        interfaces=[
            InterfaceSpec("11" * 16, "user/env", "good", "PublisherInterface", "std_msgs/String", "there"),
            InterfaceSpec("22" * 16, "user/env", "bad", "PublisherInterface", "std_msgs/Nothing", "there"),
        ],
        links=[LinkSpec(await master.link(), "00" * 16)],
        nodes=[echo, NodeSpec("missing", "probe", "nothing")],
        parameters=[ParameterSpec("two\nlines", 1)],
    )
    settled = await master.call(wanted)
    assert set(settled.failed) == {"22" * 16, "node:missing", "parameter::two\nlines"}
    settled = await master.call(Sync(links=wanted.links, nodes=[echo]))
    assert settled.failed == {}
    assert not is_alive(pid)
