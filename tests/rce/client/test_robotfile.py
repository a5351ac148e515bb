"""The runner of robot files: set-up in order, input and output lines, clean-up."""

from __future__ import annotations

import asyncio
import base64
import json
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from rce.client import Robot
from rce.client.events import Disconnected, Event, Reconnected
from rce.client.robotfile import event_text, run_file
from rce.errors import InvalidRequest, NotFound
from rce.protocol.messages import ConnectionEvent, DropEvent, EnvironmentEvent, LimitEvent, NodeEvent, RecorderEvent
from tests.support.client_contract import SET_BOOL, STRING
from tests.support.fake_platform import FakePlatform
from tests.support.robot_files import robot_file


class Console:
    """Input and output lines of a running robot."""

    def __init__(self) -> None:
        self.input: asyncio.Queue[bytes] = asyncio.Queue()
        self.output: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    async def lines(self) -> AsyncIterator[bytes]:
        while True:
            yield await self.input.get()

    def write(self, line: bytes) -> None:
        self.output.put_nowait(json.loads(line))

    async def exchange(self, line: dict[str, Any] | bytes) -> dict[str, Any]:
        self.input.put_nowait(line if isinstance(line, bytes) else json.dumps(line).encode())
        return await self.next()

    async def next(self) -> dict[str, Any]:
        return await asyncio.wait_for(self.output.get(), 60)


async def test_robot_is_set_up_in_order_processes_lines_and_is_cleaned_up(fake: FakePlatform, tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(robot_file(fake.url)))
    console = Console()
    running = asyncio.create_task(run_file(path, lines=console.lines(), write=console.write))
    try:
        message = {"iTag": "out", "msg": {"data": "hello"}}
        assert await console.exchange(message) == {"iTag": "in", "type": STRING, "msg": {"data": "hello"}}
        raw = base64.b64encode(b"\0\1\2").decode()
        assert await console.exchange({"iTag": "raw_out", "msg": raw}) == {"iTag": "raw_in", "type": STRING, "msg": raw}

        request = await console.exchange({"iTag": "call", "msgID": "mine", "msg": {"data": True}})
        assert request == {"iTag": "serve", "type": SET_BOOL, "msgID": request["msgID"], "msg": {"data": True}}
        response = await console.exchange({"iTag": "serve", "msgID": request["msgID"], "msg": {"success": True}})
        assert response == {"iTag": "call", "type": SET_BOOL, "msgID": "mine", "msg": {"success": True}}

        request = await console.exchange({"iTag": "call", "msg": {"data": False}})
        response = await console.exchange({"iTag": "serve", "msgID": request["msgID"], "error": "stuck"})
        assert "stuck" in response["error"]

        for wrong in (
            b"{",
            b'{"iTag":"none","msg":1}',
            b'{"iTag":"in","msg":1}',
            b'{"iTag":"raw_out","msg":"?"}',
            b"\n",
        ):
            console.input.put_nowait(wrong)
        assert (await console.exchange(message))["msg"] == {"data": "hello"}, "malformed lines do not end the robot"
        peer = fake.peers["a"]
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    kinds = [(frame["type"], *frame["data"]) for frame in peer.frames if frame["type"] != "DM"]
    assert [kind[-1] for kind in kinds[:5]] == [
        "containerData",
        "containerData",
        "setParam",
        "addNodes",
        "addInterfaces",
    ]
    assert kinds[-3:] == [("CN", "deleteParam"), ("DC", "containerTag"), ("DC", "containerTag")]
    assert not fake.peers


async def test_packets_of_a_codec_are_lines_with_base64(fake: FakePlatform, tmp_path: Path) -> None:
    file = {"url": fake.url, "userID": "testUser", "robotID": "a", "password": "testUser"}
    kinds = {"out": "SubscriberConverter", "in": "PublisherConverter"}
    file["interfaces"] = [  # type: ignore[assignment]
        {"eTag": "a", "iTag": tag, "iType": kind, "iCls": "sensor_msgs/PointCloud2", "codec": "draco"}
        for tag, kind in kinds.items()
    ]
    file["connections"] = [{"tagA": "a/out", "tagB": "a/in"}]  # type: ignore[assignment]
    path, console = tmp_path / "robot.json", Console()
    path.write_text(json.dumps(file))
    running = asyncio.create_task(run_file(path, lines=console.lines(), write=console.write))
    try:
        packet = {"header": {"frame_id": "map"}, "codec": "draco", "data": base64.b64encode(b"\0points").decode()}
        for wrong in ({"codec": "draco"}, {**packet, "data": "?"}, "points"):
            console.input.put_nowait(json.dumps({"iTag": "out", "msg": wrong}).encode())
        assert (await console.exchange({"iTag": "out", "msg": packet}))["msg"] == packet
        assert fake.interfaces["a/in"]["codec"] == fake.interfaces["a/out"]["codec"] == "draco"
        assert fake.interfaces["a/in"]["interfaceType"] == "PublisherConverter"
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_quality_of_service_of_topics_is_passed_on(fake: FakePlatform, tmp_path: Path) -> None:
    file = {"url": fake.url, "userID": "testUser", "robotID": "a", "password": "testUser"}
    kinds = {"out": "SubscriberConverter", "in": "PublisherConverter"}
    file["interfaces"] = [  # type: ignore[assignment]
        {"eTag": "a", "iTag": tag, "iType": kind, "iCls": STRING, "qos": {"depth": 7}} for tag, kind in kinds.items()
    ]
    file["connections"] = [{"tagA": "a/out", "tagB": "a/in"}]  # type: ignore[assignment]
    path, console = tmp_path / "robot.json", Console()
    path.write_text(json.dumps(file))
    running = asyncio.create_task(run_file(path, lines=console.lines(), write=console.write))
    try:
        assert (await console.exchange({"iTag": "out", "msg": {"data": "x"}}))["msg"] == {"data": "x"}
        assert fake.interfaces["a/in"]["qos"] == fake.interfaces["a/out"]["qos"] == {"depth": 7}
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


@pytest.mark.parametrize("option", [{"qos": {"depth": 7}}, {"delivery": {"rate": 1}}, {"codec": "jpeg"}])
async def test_options_of_topics_are_refused_for_services(
    fake: FakePlatform, tmp_path: Path, option: dict[str, Any]
) -> None:
    file = {"url": fake.url, "userID": "testUser", "robotID": "a", "password": "testUser"}
    service = {"eTag": "a", "iTag": "call", "iType": "ServiceProviderConverter", "iCls": SET_BOOL}
    file["interfaces"] = [service | option]  # type: ignore[assignment]
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(file))
    with pytest.raises(InvalidRequest, match="interface call: qos, delivery and codec are for topics"):
        await run_file(path, lines=Console().lines(), write=Console().write)


async def test_failed_set_up_is_cleaned_up(fake: FakePlatform, tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(robot_file(fake.url) | {"connections": [{"tagA": "a/out", "tagB": "a/nothing"}]}))
    with pytest.raises(NotFound):
        await run_file(path, lines=Console().lines(), write=Console().write)
    assert not [name for name in fake.resources if name[0] == "environment"]


async def test_file_may_configure_interfaces_of_other_robots(fake: FakePlatform, tmp_path: Path) -> None:
    async with Robot(fake.url, user="testUser", robot="b", password="testUser") as b:
        subscriber = await b.subscriber("in", STRING)
        path = tmp_path / "robot.yaml"
        file = robot_file(fake.url) | {"containers": [], "parameters": [], "nodes": []}
        file["interfaces"] = [
            {"eTag": "a", "iTag": "out", "iType": "SubscriberConverter", "iCls": STRING},
            {"eTag": "b", "iTag": "unused", "iType": "PublisherConverter", "iCls": STRING},
        ]
        file["connections"] = [{"tagA": "a/out", "tagB": "b/in"}]
        path.write_text(yaml.safe_dump(file))
        console = Console()
        running = asyncio.create_task(run_file(path, lines=console.lines(), write=console.write))
        console.input.put_nowait(b'{"iTag":"out","msg":{"data":"hi"}}')
        assert await subscriber.get(10) == {"data": "hi"}
        assert "b/unused" in fake.interfaces
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_process_can_exit_while_standard_input_is_read() -> None:
    program = "import asyncio; from rce.client.robotfile import standard_input; asyncio.run(anext(standard_input()))"
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdin=pipe, stderr=pipe)
    assert process.stdin is not None
    assert process.stderr is not None
    process.stdin.write(b"{}\n")  # read; then the thread waits for the next line, which does not come
    error = await asyncio.wait_for(process.stderr.read(), 60)
    assert await process.wait() == 0, error.decode()


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (EnvironmentEvent("brain", "ready"), "environment brain is ready"),
        (EnvironmentEvent("brain", "lost", "it died"), "environment brain is lost: it died"),
        (NodeEvent("brain", "echo", 1, ["oh"]), "node brain/echo ended with status 1\n  oh"),
        (RecorderEvent("brain", "box", "quota"), "recorder brain/box ended: quota"),
        (DropEvent("camera", 3, "to the robot"), "interface camera: 3 messages were dropped (to the robot)"),
        (ConnectionEvent("r1/a", "brain/b", "waiting", "away"), "connection r1/a brain/b is waiting: away"),
        (LimitEvent("too much"), "too much"),
        (Disconnected("1006"), "the connection broke (1006); reconnecting"),
        (Reconnected(True), "connected again"),
        (Reconnected(False), "connected again, with a new session"),
        (NotFound("there is no x"), "there is no x"),
    ],
)
def test_events_are_lines_for_people(event: Event, text: str) -> None:
    assert event_text(event) == text
