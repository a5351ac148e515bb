"""Frames of clients of the original, and the exact answers of the original."""

from __future__ import annotations

import asyncio
import itertools
import json
import re

import cv2
import numpy as np
import pytest
import yaml

from tests.support.e2e.original_robot import (
    OriginalRobot,
    configure,
    connection,
    container,
    destroy,
    get,
    interface,
    message,
    node,
    status,
)
from tests.support.e2e.real_platform import RealPlatform

STRING, ECHO = "std_msgs/String", "Test/StringEcho"


async def test_echo_client(platform: RealPlatform) -> None:
    """The example of the original's client library."""
    assert await get(platform.url, userID="testUser", version="20130902") == (
        200,
        "application/json; charset=utf-8",
        json.dumps({"url": await websocket(platform)}, separators=(",", ":")),
    )
    async with OriginalRobot(platform.url, "bot1") as robot:
        await robot.send(
            container("c1"),
            configure("setParam", containerTag="c1", name="int", value=99),
            node("c1", "echo", "stringEcho.py"),
            interface("c1", "req", "PublisherInterface", STRING, addr="stringEchoReq"),
            interface("bot1", "req", "SubscriberConverter", STRING),
            interface("c1", "resp", "SubscriberInterface", STRING, addr="stringEchoResp"),
            interface("bot1", "resp", "PublisherConverter", STRING),
            connection("c1/req", "bot1/req"),
            connection("c1/resp", "bot1/resp"),
        )
        await robot.take_frame(status("req", True), status("resp", True))
        await until_discovered(robot)
        await robot.send(message("req", STRING, {"data": "hello"}))
        data = await robot.take_data("resp")
        assert re.fullmatch("[0-9a-f]{32}", data.pop("msgID"))
        assert data == {"iTag": "resp", "type": STRING, "msg": {"data": "hello"}}
        await robot.send(configure("deleteParam", containerTag="c1", name="int"), destroy("c1"))
        await robot.take_frame(status("req", False), status("resp", False))
        await robot.commands_processed()
        assert robot.received == []


async def until_discovered(robot: OriginalRobot) -> None:
    """Send numbers until one comes back, and take those after it: they are lost until DDS discovery has finished."""
    async with asyncio.timeout(60):
        for number in itertools.count():
            await robot.send(message("req", STRING, {"data": str(number)}))
            try:
                data = await robot.take_data("resp", 1)
            except AssertionError:
                continue
            while data["msg"] != {"data": str(number)}:
                data = await robot.take_data("resp")
            return


async def websocket(platform: RealPlatform) -> str:
    _, _, body = await get(platform.url, userID="testUser", version="20130902")
    found: str = json.loads(body)["url"]
    assert re.fullmatch(r"ws://127\.0\.0\.1:\d+/", found)
    return found


@pytest.mark.parametrize(
    ("query", "code", "word"),
    [
        ({"userID": "testUser", "version": "20130415"}, 200, '"current":"20130902"'),
        ({"userID": "nobodyKnows", "version": "20130902"}, 200, '"url"'),
        ({"userID": "testUser"}, 400, "version"),
        ({"version": "20130902"}, 400, "userID"),
        ({"userID": "testUser", "version": "20130210"}, 410, "20130415"),
        ({"userID": "testUser", "version": "20991231"}, 501, "20130902"),
    ],
)
async def test_entry(platform: RealPlatform, query: dict[str, str], code: int, word: str) -> None:
    found, kind, body = await get(platform.url, **query)
    assert (found, kind) == (code, f"{'application/json' if code == 200 else 'text/plain'}; charset=utf-8")
    assert word in body


async def test_services_in_both_directions(platform: RealPlatform) -> None:
    """The robot calls a node's service, and answers calls of its own service."""
    async with OriginalRobot(platform.url, "caller") as robot:
        await robot.send(
            container("services"),
            node("services", "echo", "stringEcho.py"),
            interface("services", "echo", "ServiceClientInterface", ECHO, addr="/stringEchoService"),
            interface("caller", "echo", "ServiceProviderConverter", ECHO),
            connection("services/echo", "caller/echo"),
            # A call loops from the robot through the environment to the service that the robot provides.
            interface("services", "offer", "ServiceProviderInterface", ECHO, addr="/robotService"),
            interface("caller", "serve", "ServiceClientConverter", ECHO),
            connection("services/offer", "caller/serve"),
            interface("services", "use", "ServiceClientInterface", ECHO, addr="/robotService"),
            interface("caller", "use", "ServiceProviderConverter", ECHO),
            connection("services/use", "caller/use"),
        )
        await robot.take_frame(status("echo", True), status("serve", True), status("use", True))
        answer = await robot.call("echo", ECHO, {"data": "hi"}, "5d0c8a")
        assert answer == message("echo", ECHO, {"data": "hi"}, "5d0c8a")["data"]

        await robot.send(message("use", ECHO, {"data": "ask"}, "mine"))
        asked = await robot.take_data("serve")
        assert asked["type"] == ECHO
        assert asked["msg"] == {"data": "ask"}
        assert re.fullmatch("[0-9a-f]{32}", asked["msgID"])
        await robot.send(message("serve", ECHO, {"data": "answer"}, asked["msgID"]))
        assert await robot.take_data("use") == message("use", ECHO, {"data": "answer"}, "mine")["data"]
        await robot.send(destroy("services"))
        await robot.take_frame(status("echo", False), status("serve", False), status("use", False))
        await robot.commands_processed()
        assert robot.received == []


async def test_parameters_of_all_kinds(platform: RealPlatform) -> None:
    """Parameters of the original's debug configuration, set before the node starts."""
    values = {"int": 99, "str": "$(find Test)", "float": 3.14, "bool": True}
    mixed = ["one", 2, "three", "true"]
    async with OriginalRobot(platform.url, "setter") as robot:
        await robot.send(
            container("parameters"),
            *(configure("setParam", containerTag="parameters", name=name, value=values[name]) for name in values),
            configure("setParam", containerTag="parameters", name="list", value=mixed),
            node("parameters", "params", "paramTest.py"),
            interface("parameters", "ask", "ServiceClientInterface", "Test/ParameterTest", addr="/parameterTest"),
            interface("setter", "ask", "ServiceProviderConverter", "Test/ParameterTest"),
            connection("parameters/ask", "setter/ask"),
        )
        await robot.take_frame(status("ask", True))
        told = json.loads((await robot.call("ask", "Test/ParameterTest", {}, "1"))["msg"]["msg"])
        assert told.pop("str").endswith("Test")
        assert yaml.safe_load(told.pop("list")) == mixed
        assert told == {name: values[name] for name in told}
        await robot.send(destroy("parameters"))
        await robot.take_frame(status("ask", False))
        await robot.commands_processed()
        assert robot.received == []


async def test_peculiarities_of_the_cpp_client(platform: RealPlatform) -> None:
    """The C++ client always sends `addr`, uses names of 2012 for service clients, and may send a blob first."""
    image = "sensor_msgs/Image"
    picture = np.full((2, 3), 7, np.uint8)
    png = cv2.imencode(".png", picture)[1].tobytes()
    name = "0a1b2c3d4e5f60718293a4b5c6d7e8f9"
    async with OriginalRobot(platform.url, "cpp") as robot:
        await robot.send(
            {"type": "CC", "data": {"containerTag": "old"}},
            node("old", "echo", "stringEcho.py", args="", name="", namespace=""),
            interface("old", "echo", "ServiceInterface", ECHO, addr="stringEchoService"),
            interface("cpp", "echo", "ServiceProviderConverter", ECHO, addr=""),
            interface("cpp", "serve", "ServiceConverter", ECHO, addr=""),
            interface("old", "offer", "ServiceProviderInterface", ECHO, addr="/offered"),
            interface("cpp", "fserve", "ServiceForwarder", ECHO, addr=""),
            interface("cpp", "out", "SubscriberConverter", image, addr=""),
            interface("cpp", "in", "PublisherConverter", image, addr=""),
            connection("old/echo", "cpp/echo"),
            connection("cpp/serve", "old/offer"),
            connection("cpp/in", "cpp/out"),
        )
        await robot.take_frame(*(status(tag, True) for tag in ("echo", "serve", "in", "out")))
        assert (await robot.call("echo", ECHO, {"data": "hi"}, "7"))["msg"] == {"data": "hi"}
        await robot.send(name.encode() + png, message("out", image, name, key="msg*"))
        got = await robot.take_data("in")
        blob = await robot.take_blob(got["msg*"])
        seen = cv2.imdecode(np.frombuffer(blob, np.uint8), cv2.IMREAD_UNCHANGED)
        assert seen is not None
        assert np.array_equal(seen, picture)
        await robot.send(destroy("old"))
        await robot.take_frame(status("echo", False), status("serve", False))
        await robot.commands_processed()
        assert robot.received == []


ASYNCHRONOUS = [
    ("illegal tag", container("1bad"), "1bad"),
    ("tag used twice", container("errors"), "errors"),
    ("robot's tag", container("wrong"), "wrong"),
    ("no container", node("missing", "n", "stringEcho.py"), "missing"),
    ("no package", configure("addNodes", containerTag="errors", nodeTag="n", pkg="NoPkg", exe="x"), "NoPkg"),
    ("no executable", node("errors", "n", "none.py"), "none.py"),
    ("no variable", node("errors", "n", "stringEcho.py", args="$(env NOT_SET)"), "NOT_SET"),
    ("interface type", interface("wrong", "x", "PublisherNonsense", STRING), "PublisherNonsense"),
    ("wrong place", interface("wrong", "x", "PublisherInterface", STRING), "environment 'wrong'"),
    ("no such type", interface("errors", "x", "PublisherInterface", "nope/Nope", addr="x"), "nope"),
    ("no such type", interface("wrong", "x", "PublisherConverter", "nope/Nope"), "nope"),
    ("tag used twice", interface("wrong", "pub", "PublisherConverter", STRING), "pub"),
    ("no interface", connection("wrong/pub", "errors/none"), "errors/none"),
    ("no slash", connection("wrongpub", "errors/none"), "wrongpub"),
    ("types differ", connection("wrong/pub", "errors/pose"), "Pose2D"),
    ("not a pair", connection("wrong/pub", "wrong/pub2"), "PublisherConverter"),
    ("connected twice", connection("errors/sub", "wrong/pub"), "connected"),
    ("not connected", connection("errors/sub", "wrong/pub2", "disconnect"), "not connected"),
    ("no parameter", configure("deleteParam", containerTag="errors", name="nothing"), "nothing"),
    ("no node", configure("removeNodes", containerTag="errors", nodeTag="none"), "none"),
    ("no interface", configure("removeInterfaces", endpointTag="errors", interfaceTag="none"), "none"),
    ("no container", destroy("missing"), "missing"),
    ("subnet", container("grouped", group="g", groupIP="10.0.0.1"), "10.0.0.1"),
    ("subnet, as clients spell it", container("grouped", group="g", groupIp="10.0.0.2"), "10.0.0.2"),
    ("too large", container("large", size=500), "500"),
]


async def test_each_failed_command_is_reported(platform: RealPlatform) -> None:
    """Each failed command gets one error, a plain string, even those that the original only logged."""
    async with OriginalRobot(platform.url, "wrong") as robot:
        await robot.send(
            container("errors"),
            interface("wrong", "pub", "PublisherConverter", STRING),
            interface("wrong", "pub2", "PublisherConverter", STRING),
            interface("errors", "sub", "SubscriberInterface", STRING, addr="t"),
            interface("errors", "pose", "SubscriberInterface", "geometry_msgs/Pose2D", addr="p"),
            connection("wrong/pub", "errors/sub"),
        )
        await robot.take_frame(status("pub", True))
        for what, frame, word in ASYNCHRONOUS:
            print(what)  # shown if the error does not arrive
            await robot.send(frame)
            error = await robot.take_error()
            assert word in error, what
            assert not error.startswith("Invalid Request"), "that is for what the Robot process finds itself"
        await robot.send(destroy("errors"))
        await robot.take_frame(status("pub", False))
        await robot.commands_processed()
        assert robot.received == []


async def test_malformed_frames_are_refused(platform: RealPlatform) -> None:
    async with OriginalRobot(platform.url, "nonsense") as robot:
        await robot.send(
            interface("nonsense", "out", "SubscriberConverter", STRING),
            interface("nonsense", "in", "PublisherConverter", STRING),
            connection("nonsense/out", "nonsense/in"),
        )
        await robot.take_frame(status("out", True), status("in", True))
        for frame in (
            "{not json",
            "[]",
            {"type": "ST", "data": {"topic": "iu", "iTag": "x", "status": True}},
            {"type": "ER", "data": "text"},
            {"type": "XY", "data": {}},
            {"type": "CC", "data": {}},
            configure("addNodes", containerTag="c"),
            message("out", STRING, {"data": "x"}, "m" * 256),
            message("out", "std_msgs/Bool", {"data": True}),
        ):
            await robot.send(frame)
            assert (await robot.take_error()).startswith("Invalid Request: "), frame
        await robot.send(message("none", STRING, {"data": "x"}))
        assert "none" in await robot.take_error()
        await robot.commands_processed()
        assert robot.received == []
