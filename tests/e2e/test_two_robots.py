"""A network of robots: Master and Robot endpoint, without environments and ROS."""

from __future__ import annotations

import asyncio
import json
import os
import random
import secrets
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.e2e.original_robot import OriginalRobot, configure, connection, container, interface, message, status
from tests.support.e2e.real_platform import RCE

IMAGE, STRING, SET_BOOL = "sensor_msgs/Image", "std_msgs/String", "std_srvs/SetBool"
BLOB = "00112233445566778899aabbccddeeff"


@asynccontextmanager
async def running(name: str, *words: str, **environment: str) -> AsyncIterator[dict[str, str]]:
    """Run a program of the platform and yield its ready line."""
    process = await asyncio.create_subprocess_exec(
        RCE, name, *words, stdout=asyncio.subprocess.PIPE, env={**os.environ, **environment}
    )
    try:
        assert process.stdout is not None
        yield json.loads(await asyncio.wait_for(process.stdout.readline(), 120))
        process.send_signal(signal.SIGTERM)
        assert await asyncio.wait_for(process.wait(), 60) == 0
    finally:
        if process.returncode is None:
            process.kill()


@pytest.fixture(scope="module")
async def entry(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[str]:
    """Entry of a Master with one Robot endpoint."""
    directory: Path = tmp_path_factory.mktemp("network")
    token = secrets.token_hex(32)
    listen = "tcp:0:interface=127.0.0.1"
    words = (f"--data-dir={directory / 'master'}", f"--http={listen}", f"--control={listen}", "--dev")
    async with running("master", *words, RCE_TOKENS=f"robot:robot-1:{token}") as master:
        words = (f"--data-dir={directory / 'robot'}", f"--master={master['control']}", "--ws-port=0")
        async with running("robot", *words, RCE_TOKEN=token):
            yield master["url"]


@pytest.fixture
async def robots(entry: str) -> AsyncIterator[tuple[OriginalRobot, OriginalRobot]]:
    name = secrets.token_hex(4)
    async with OriginalRobot(entry, f"ann_{name}") as ann, OriginalRobot(entry, f"bob_{name}") as bob:
        yield ann, bob


async def wire(one: OriginalRobot, other: OriginalRobot, tag: str, kinds: tuple[str, str], type_name: str) -> None:
    """Connect an interface of each; the first kind is that of `one`."""
    await other.send(interface(other.name, tag, kinds[1], type_name))
    await other.commands_processed()
    await one.send(
        interface(one.name, tag, kinds[0], type_name), connection(f"{one.name}/{tag}", f"{other.name}/{tag}")
    )
    await asyncio.gather(one.take_frame(status(tag, True)), other.take_frame(status(tag, True)))


async def test_topics_and_services_in_both_directions(robots: tuple[OriginalRobot, OriginalRobot]) -> None:
    for one, other in (robots, robots[::-1]):
        await wire(one, other, f"t_{one.name}", ("SubscriberConverter", "PublisherConverter"), STRING)
        await one.send(message(f"t_{one.name}", STRING, {"data": "Grüße"}))
        assert (await other.take_data(f"t_{one.name}"))["msg"] == {"data": "Grüße"}

        tag = f"s_{one.name}"
        await wire(one, other, tag, ("ServiceProviderConverter", "ServiceClientConverter"), SET_BOOL)
        await one.send(message(tag, SET_BOOL, {"data": True}, "mine"))
        request = await other.take_data(tag)
        assert request["msg"] == {"data": True}
        await other.send(message(tag, SET_BOOL, {"success": True, "message": "done"}, request["msgID"]))
        assert await one.take_data(tag) == message(tag, SET_BOOL, {"success": True, "message": "done"}, "mine")["data"]
    for robot in robots:
        await robot.commands_processed()
        assert robot.received == []


async def test_forwarders_do_not_change_bytes(robots: tuple[OriginalRobot, OriginalRobot]) -> None:
    one, other = robots
    await wire(one, other, "bytes", ("SubscriberForwarder", "PublisherForwarder"), "no_such/Type")
    for size in (0, 1, 1_000_000):
        payload = random.randbytes(size)
        await one.send(message("bytes", "no_such/Type", BLOB, key="msg*"), BLOB.encode() + payload)
        got = await other.take_data("bytes")
        assert await other.take_blob(got["msg*"]) == payload
    await wire(one, other, "ask", ("ServiceProviderForwarder", "ServiceClientForwarder"), "no_such/Service")
    await one.send(message("ask", "no_such/Service", BLOB, "1", key="msg*"), BLOB.encode() + b"question")
    request = await other.take_data("ask")
    assert await other.take_blob(request["msg*"]) == b"question"
    await other.send(message("ask", "no_such/Service", BLOB, request["msgID"], key="msg*"), BLOB.encode() + b"answer")
    got = await one.take_data("ask")
    assert await one.take_blob(got["msg*"]) == b"answer"


async def test_forwarder_and_converter(robots: tuple[OriginalRobot, OriginalRobot]) -> None:
    one, other = robots
    await wire(one, other, "mixed", ("SubscriberForwarder", "PublisherConverter"), STRING)
    cdr = b"\x00\x01\x00\x00\x06\x00\x00\x00hello\x00"
    await one.send(message("mixed", STRING, BLOB, key="msg*"), BLOB.encode() + cdr)
    assert (await other.take_data("mixed"))["msg"] == {"data": "hello"}
    await wire(other, one, "back", ("SubscriberConverter", "PublisherForwarder"), STRING)
    await other.send(message("back", STRING, {"data": "hello"}))
    got = await one.take_data("back")
    assert (await one.take_blob(got["msg*"]))[:14] == cdr[:14]


async def test_image_arrives_as_png(robots: tuple[OriginalRobot, OriginalRobot]) -> None:
    one, other = robots
    await wire(one, other, "camera", ("SubscriberConverter", "PublisherConverter"), IMAGE)
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    png = cv2.imencode(".png", picture)[1].tobytes()
    await one.send(message("camera", IMAGE, BLOB, key="msg*"), BLOB.encode() + png)
    got = await other.take_data("camera")
    blob = await other.take_blob(got["msg*"])
    assert blob.startswith(b"\x89PNG")
    seen = cv2.imdecode(np.frombuffer(blob, np.uint8), cv2.IMREAD_COLOR)
    assert seen is not None
    assert np.array_equal(seen, picture)


async def test_environment_without_machine_is_refused(robots: tuple[OriginalRobot, OriginalRobot]) -> None:
    await robots[0].send(container("brain"))
    assert "machine" in await robots[0].take_error()


async def test_interface_without_peer_goes_down(robots: tuple[OriginalRobot, OriginalRobot]) -> None:
    """Messages are then dropped without an error, as in the original."""
    one, other = robots
    await wire(one, other, "t", ("SubscriberConverter", "PublisherConverter"), STRING)
    await other.send(configure("removeInterfaces", endpointTag=other.name, interfaceTag="t"))
    await asyncio.gather(one.take_frame(status("t", False)), other.take_frame(status("t", False)))
    await one.send(message("t", STRING, {"data": "x"}))
    await one.send(message("other", STRING, {"data": "x"}))
    assert "no interface 'other'" in await one.take_error()
    assert one.received == []
