"""A robot from a file: its format, its set-up in order, its lines, and its end."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from client_contract import SET_BOOL, STRING
from fake_platform import FakePlatform

from rce.client import Robot
from rce.client.robotfile import run_file
from rce.client.robotformat import RobotFile, read
from rce.errors import InvalidRequest, NotFound


def content(url: str = "http://127.0.0.1:9000/") -> dict[str, Any]:
    """As the original's test/debug.cfg, in small, with every kind of interface on the robot."""

    def own(tag: str, kind: str, name: str) -> dict[str, str]:
        return {"eTag": "a", "iTag": tag, "iType": kind, "iCls": name, "addr": f"/{tag}"}

    return {
        "url": url,
        "userID": "testUser",
        "robotID": "a",
        "password": "testUser",
        "containers": [{"cTag": "c1"}, {"cTag": "c2", "group": "net", "size": 2}],
        "parameters": [{"cTag": "c1", "name": "list", "value": [1, 2]}],
        "nodes": [{"cTag": "c1", "nTag": "echo", "pkg": "Test", "exe": "stringEcho.py", "args": "--x"}],
        "interfaces": [
            {"eTag": "c1", "iTag": "req", "iType": "PublisherInterface", "iCls": STRING, "addr": "/req"},
            own("say", "SubscriberConverter", STRING),
            own("hear", "PublisherConverter", STRING),
            own("send", "SubscriberForwarder", STRING),
            own("take", "PublisherForwarder", STRING),
            own("ask", "ServiceProviderConverter", SET_BOOL),
            own("answer", "ServiceClientConverter", SET_BOOL),
        ],
        "connections": [
            {"tagA": "a/say", "tagB": "a/hear"},
            {"tagA": "a/take", "tagB": "a/send"},
            {"tagA": "a/ask", "tagB": "a/answer"},
        ],
    }


class Console:
    """Both ends of the lines of a running robot."""

    def __init__(self) -> None:
        self.given: asyncio.Queue[bytes] = asyncio.Queue()
        self.written: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    async def lines(self) -> AsyncIterator[bytes]:
        while True:
            yield await self.given.get()

    def write(self, line: bytes) -> None:
        self.written.put_nowait(json.loads(line))

    async def ask(self, line: dict[str, Any] | bytes) -> dict[str, Any]:
        self.given.put_nowait(line if isinstance(line, bytes) else json.dumps(line).encode())
        return await self.next()

    async def next(self) -> dict[str, Any]:
        return await asyncio.wait_for(self.written.get(), 10)


@pytest.mark.parametrize("suffix", [".cfg", ".json", ".yaml", ".yml"])
def test_json_and_yaml_say_the_same(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"robot{suffix}"
    path.write_text(yaml.safe_dump(content()) if "y" in suffix else json.dumps(content()))
    file = read(path)
    assert isinstance(file, RobotFile)
    assert file.containers[1].group == "net"
    assert file.parameters[0].value == [1, 2]
    assert file.interfaces[0].addr == "/req"


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"url": None}, "url: Expected `str`"),
        ({"nodes": [{"cTag": "c1", "nTag": "n", "exe": "x"}]}, r"nodes\[0\]: .*`pkg`"),
        ({"interfaces": [{"eTag": "a", "iTag": "i", "iType": "Publisher", "iCls": "a/B"}]}, r"interfaces\[0\].iType"),
        ({"parameters": [{"cTag": "c", "name": "x", "value": {}}]}, r"parameters\[0\].value"),
        ({"conections": []}, "unknown field `conections`"),
    ],
)
def test_errors_name_the_file_and_the_place(tmp_path: Path, change: dict[str, Any], where: str) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(content() | change))
    with pytest.raises(InvalidRequest, match=f"robot.json: .*{where}"):
        read(path)


@pytest.mark.parametrize(
    ("name", "text"), [("a.json", '{"url": \n nonsense}'), ("a.yaml", "url:\n\t- x: ["), ("b", "")]
)
def test_what_cannot_be_parsed_is_told_with_its_line(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InvalidRequest, match=rf"{name}: [^$]*line \d"):
        read(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"nothing\.json"):
        read(tmp_path / "nothing.json")


async def test_a_file_is_set_up_in_order_serves_its_lines_and_is_undone(fake: FakePlatform, tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(content(fake.url)))
    console = Console()
    running = asyncio.create_task(run_file(path, lines=console.lines(), write=console.write))
    try:
        said = {"iTag": "say", "msg": {"data": "hello"}}
        assert await console.ask(said) == {"iTag": "hear", "type": STRING, "msg": {"data": "hello"}}
        raw = base64.b64encode(b"\0\1\2").decode()
        assert await console.ask({"iTag": "send", "msg": raw}) == {"iTag": "take", "type": STRING, "msg": raw}

        request = await console.ask({"iTag": "ask", "msgID": "mine", "msg": {"data": True}})
        assert request == {"iTag": "answer", "type": SET_BOOL, "msgID": request["msgID"], "msg": {"data": True}}
        response = await console.ask({"iTag": "answer", "msgID": request["msgID"], "msg": {"success": True}})
        assert response == {"iTag": "ask", "type": SET_BOOL, "msgID": "mine", "msg": {"success": True}}

        request = await console.ask({"iTag": "ask", "msg": {"data": False}})
        response = await console.ask({"iTag": "answer", "msgID": request["msgID"], "error": "stuck"})
        assert "stuck" in response["error"]

        for wrong in (
            b"{",
            b'{"iTag":"none","msg":1}',
            b'{"iTag":"hear","msg":1}',
            b'{"iTag":"send","msg":"?"}',
            b"\n",
        ):
            console.given.put_nowait(wrong)
        assert (await console.ask(said))["msg"] == {"data": "hello"}, "wrong lines do not end the robot"
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


async def test_what_was_set_up_before_a_failure_is_undone(fake: FakePlatform, tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(content(fake.url) | {"connections": [{"tagA": "a/say", "tagB": "a/nothing"}]}))
    with pytest.raises(NotFound):
        await run_file(path, lines=Console().lines(), write=Console().write)
    assert not [name for name in fake.names if name[0] == "environment"]


async def test_a_file_may_configure_interfaces_of_other_robots(fake: FakePlatform, tmp_path: Path) -> None:
    async with Robot(fake.url, user="testUser", robot="b", password="testUser") as b:
        heard = await b.subscriber("heard", STRING)
        path = tmp_path / "robot.yaml"
        file = content(fake.url) | {"containers": [], "parameters": [], "nodes": []}
        file["interfaces"] = [
            {"eTag": "a", "iTag": "say", "iType": "SubscriberConverter", "iCls": STRING},
            {"eTag": "b", "iTag": "unused", "iType": "PublisherConverter", "iCls": STRING},
        ]
        file["connections"] = [{"tagA": "a/say", "tagB": "b/heard"}]
        path.write_text(yaml.safe_dump(file))
        console = Console()
        running = asyncio.create_task(run_file(path, lines=console.lines(), write=console.write))
        console.given.put_nowait(b'{"iTag":"say","msg":{"data":"hi"}}')
        assert await heard.get(10) == {"data": "hi"}
        assert "b/unused" in fake.interfaces
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
