"""Requests of nodes on the robot, by topic and by service, and the reports of their progress."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from twisted.logger import LogEvent

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.bridge.config import Action, EndRecording, Record, StartOffloading
from endpoints.bridge.requests import REQUESTS, RESPONSES, STRING, TRIGGER, RequestServer
from rce.errors import NotFound
from rce.protocol.blobs import Buffer
from rce.protocol.names import parse_type
from tests.support.endpoints.fake_local_ros import FakeInterface, FakeLocalRos

TEXT = TypeRegistry().message(parse_type(STRING))
ANSWER = TypeRegistry().service(parse_type(TRIGGER)).response
ACTIONS: dict[str, Action] = {"on": StartOffloading(), "rec": Record({}, Path("/bags")), "enough": EndRecording()}


class Robot:
    """Nodes of the robot; `perform` executes their actions as the test says."""

    def __init__(self, local: FakeLocalRos) -> None:
        self.local = local
        self.performed: list[Action] = []
        self.gate = asyncio.Event()
        self.gate.set()
        self.cancelled = False

    async def perform(self, action: Action) -> str:
        self.performed.append(action)
        try:
            await self.gate.wait()
        except asyncio.CancelledError:
            self.cancelled = True
            raise
        if isinstance(action, EndRecording):
            raise NotFound("no recording is in progress")
        return "it is done"

    def ask(self, name: str) -> None:
        self.local.interfaces[REQUESTS].send(string(name))

    async def responses(self, count: int) -> list[tuple[str, str, str]]:
        """Return the responses once there are `count`: id, state and message of each."""
        await received(self.local.interfaces[RESPONSES], count)
        texts = [
            msgspec.json.decode(TEXT.decode(cdr).raw)["data"] for cdr in self.local.interfaces[RESPONSES].payloads()
        ]
        return [tuple(json.loads(text).values()) for text in texts]

    async def call(self, name: str) -> Any:
        """Call the service of a request; return its response."""
        there = self.local.interfaces[f"/cloud/{name}"]
        there.send(b"\0\1\0\0", "number 5")
        await received(there, 1)
        (answer,) = there.received
        assert answer.msg_id == "number 5"
        return msgspec.json.decode(ANSWER.decode(answer.payload).raw)


async def received(interface: FakeInterface, count: int) -> None:
    async with asyncio.timeout(60):
        while len(interface.received) < count:  # noqa: ASYNC110  # it takes a few turns of the loop
            await asyncio.sleep(0)


def string(text: str) -> Buffer:
    return TEXT.encode(Wire(False, msgspec.json.encode({"data": text}), {}))


@pytest.fixture
async def robot(local: FakeLocalRos) -> AsyncIterator[Robot]:
    made = Robot(local)
    server = RequestServer(ACTIONS, made.perform)
    await server.open(local)
    yield made
    server.close()


async def test_each_action_has_a_service_beside_the_topic(robot: Robot) -> None:
    assert set(robot.local.interfaces) == {REQUESTS, RESPONSES, "/cloud/on", "/cloud/rec", "/cloud/enough"}


async def test_request_by_topic_is_accepted_and_done(robot: Robot) -> None:
    robot.ask(" on\n")
    assert await robot.responses(2) == [("on", "accepted", ""), ("on", "done", "it is done")]
    assert robot.performed == [StartOffloading()]


async def test_request_by_service_is_answered_and_reported(robot: Robot) -> None:
    assert await robot.call("on") == {"success": True, "message": "it is done"}
    assert await robot.responses(2) == [("on", "accepted", ""), ("on", "done", "it is done")]


async def test_failed_action_is_reported_with_its_reason(robot: Robot) -> None:
    reason = "no recording is in progress"
    robot.ask("enough")
    assert await robot.responses(2) == [("enough", "accepted", ""), ("enough", "failed", reason)]
    assert await robot.call("enough") == {"success": False, "message": reason}


async def test_defect_of_an_action_is_reported_too(
    robot: Robot, failures: list[LogEvent], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def break_down() -> None:
        raise IndexError("list index out of range")

    monkeypatch.setattr(robot.gate, "wait", break_down)
    robot.ask("rec")
    _, (name, state, message) = await robot.responses(2)
    assert (name, state) == ("rec", "failed")
    assert "IndexError" in message
    failures.clear()


async def test_unknown_request_fails_and_names_the_known_ones(robot: Robot) -> None:
    robot.ask("dance")
    ((name, state, reason),) = await robot.responses(1)
    assert (name, state) == ("dance", "failed")
    assert "on, rec, enough" in reason
    assert robot.performed == []


async def test_request_that_is_no_string_fails(robot: Robot) -> None:
    robot.local.interfaces[REQUESTS].send(b"\0\1\0\0\3\0\0\0\xff\xff\0")  # not UTF-8
    ((name, state, reason),) = await robot.responses(1)
    assert (name, state) == ("", "failed")
    assert reason
    robot.ask("on")
    assert (await robot.responses(3))[-1] == ("on", "done", "it is done")


async def test_requests_are_executed_concurrently(robot: Robot) -> None:
    robot.gate.clear()
    robot.ask("on")
    robot.ask("rec")
    assert [state for _, state, _ in await robot.responses(2)] == ["accepted", "accepted"]
    robot.gate.set()
    assert {name for name, state, _ in await robot.responses(4) if state == "done"} == {"on", "rec"}


async def test_close_cancels_requests_in_progress(local: FakeLocalRos) -> None:
    robot = Robot(local)
    robot.gate.clear()
    server = RequestServer(ACTIONS, robot.perform)
    await server.open(local)
    robot.ask("on")
    await robot.responses(1)
    server.close()
    async with asyncio.timeout(60):
        while not robot.cancelled:  # noqa: ASYNC110
            await asyncio.sleep(0)
    assert len(await robot.responses(1)) == 1
