"""The examples of npm `@foxglove/ws-protocol-examples` at the gateway of a real platform.

`simple-client` is not among them: it knows messages in JSON and protobuf only, and those of ROS 2 are CDR. The servers
and `mcap-play` are no clients.
"""

from __future__ import annotations

import asyncio
import base64
import json
import re
import signal
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")
pytest.importorskip("DracoPy", reason="needs DracoPy: pip install '.[draco]'")

import av
import DracoPy

from converters import TypeRegistry
from rce.client import Environment
from rce.protocol.messages import Qos
from rce.protocol.names import parse_type
from tests.support.e2e.consoles import rce
from tests.support.e2e.foreign_suites import node_modules
from tests.support.e2e.gateways import Gateway, open_gateway, publish_camera_and_cloud
from tests.support.e2e.node import node_command
from tests.support.e2e.real_platform import RealPlatform, until
from tests.support.programs import running

PROGRAM = "@foxglove/ws-protocol-examples/dist/cjs/ws-protocol-examples/src/index.js"
WAIT = 60.0  # seconds
STRING = "std_msgs/String"
MESSAGE_SIZE = 32  # bytes in a frame of the WebSocket


@pytest.fixture(scope="module")
async def gateway(platform: RealPlatform, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Gateway]:
    async with open_gateway(platform, tmp_path_factory.mktemp("home"), "viewed") as gateway:
        yield gateway


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    modules = node_modules(tmp_path_factory.mktemp("foxglove"), "@foxglove/ws-protocol-examples@0.10.0")
    return modules / PROGRAM


class Example:
    """An example that runs; its output so far is `output`."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self.output = ""

    async def expect(self, pattern: str) -> None:
        """Wait until the output has a match, or the end."""
        assert self._process.stdout is not None
        async with asyncio.timeout(WAIT):
            while not re.search(pattern, self.output):
                chunk = await self._process.stdout.read(65536)
                assert chunk, f"ended without {pattern!r}: {self.output}"
                self.output += chunk.decode()

    def bytes_read(self) -> int:
        """Return the number of bytes that it has read from files and sockets."""
        return int(psutil.Process(self._process.pid).io_counters().read_chars)

    async def finish(self, number: int = 0) -> str:
        """Send a signal, if one is given, and return the output at the end."""
        if number:
            self._process.send_signal(number)
        rest, _ = await asyncio.wait_for(self._process.communicate(), WAIT)
        return self.output + rest.decode()


@asynccontextmanager
async def run_example(examples: Path, *words: str) -> AsyncIterator[Example]:
    program = *node_command(), str(examples), *words
    async with running(*program, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        yield Example(process)


@asynccontextmanager
async def publishing(environment: Environment, topic: str) -> AsyncIterator[None]:
    """Publish on a topic ten times a second."""
    publisher = await environment.publisher(topic, STRING, qos=Qos(depth=10))

    async def publish() -> None:
        while True:
            await publisher.publish({"data": "recorded"})
            await asyncio.sleep(0.1)

    task = asyncio.create_task(publish())
    try:
        yield
    finally:
        task.cancel()
        await publisher.close()


@pytest.mark.parametrize("encoding", ["json", "cdr"])
async def test_publish_client(gateway: Gateway, examples: Path, encoding: str) -> None:
    subscriber = await gateway.environment.subscriber("/chatter", STRING)
    async with run_example(examples, "publish-client", "-e", encoding, gateway.foxglove):
        assert (await subscriber.get(WAIT))["data"].startswith("hello world")
    await subscriber.close()


async def receive_packets(viewer: ClientConnection, topics: set[str]) -> dict[str, Any]:
    """Subscribe to channels as they are advertised; return one message of each, decoded by its type."""
    types: dict[int, tuple[str, str]] = {}
    found: dict[str, Any] = {}
    async for received in viewer:
        if isinstance(received, bytes):
            topic, type_name = types[int.from_bytes(received[1:5], "little")]
            value = TypeRegistry().message(parse_type(type_name), "json").decode(received[13:]).raw
            found.setdefault(topic, json.loads(bytes(value)))
            if found.keys() == topics:
                break
            continue
        for channel in json.loads(received).get("channels", []):
            if channel["topic"] in topics:
                number = channel["id"]
                types[number] = channel["topic"], channel["schemaName"]
                subscription = {"id": number, "channelId": number}
                await viewer.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
    return found


async def test_viewer_gets_video_and_draco(gateway: Gateway) -> None:
    publishing = asyncio.create_task(publish_camera_and_cloud(gateway.environment))
    url = f"{gateway.foxglove}/?codec=h264,draco&size=32x24&rate=5"
    try:
        async with connect(url, subprotocols=[Subprotocol("foxglove.sdk.v1")]) as viewer, asyncio.timeout(WAIT):
            found = await receive_packets(viewer, {"/camera", "/camera/h264", "/cloud/draco"})
    finally:
        publishing.cancel()
        await asyncio.gather(publishing, return_exceptions=True)
    video, cloud = found["/camera/h264"], found["/cloud/draco"]
    assert [each["frame_id"] for each in (video, cloud)] == ["cam", "map"]
    assert (found["/camera"]["width"], found["/camera"]["height"]) == (32, 24)
    frames = av.CodecContext.create("h264", "r").decode(av.Packet(base64.b64decode(video["data"])))
    frames += av.CodecContext.create("h264", "r").decode(None) if not frames else []
    pixels = frames[0].to_ndarray(format="rgb24")
    assert pixels.shape == (24, 32, 3)
    assert np.abs(pixels.mean(axis=(0, 1)) - (255, 0, 0)).max() < 16
    points = DracoPy.decode(base64.b64decode(cloud["data"])).points
    assert np.abs(np.sort(points, axis=0) - [[1, 2, 3], [4, 5, 6]]).max() < 0.01


async def test_service_client(gateway: Gateway, examples: Path) -> None:
    def answer(request: Any) -> Any:
        return {"success": request["data"], "message": "as you like"}

    provider = await gateway.environment.service_provider("/set_bool", "std_srvs/SetBool", answer)
    async with run_example(examples, "service-client", gateway.foxglove) as example:
        output = await example.finish()
    assert "callId: 123" in output
    assert "encoding: 'cdr'" in output
    await provider.close()


async def test_param_client(gateway: Gateway, examples: Path) -> None:
    async with run_example(examples, "param-client", gateway.foxglove) as example:
        await example.expect(r"/example_fibonacci\.use_sim_time', value: false")
        await example.expect(r"parameter updates\n.*/example_fibonacci\.use_sim_time', value: true")


async def test_perf_test_client(gateway: Gateway, examples: Path) -> None:
    async with (
        publishing(gateway.environment, "/measured"),
        run_example(examples, "perf-test-client", gateway.foxglove) as example,
    ):
        await received(gateway, example, "/measured")
        output = await example.finish(signal.SIGINT)
    found = re.search(r"\| /measured +\| (\d+)", output)
    assert found is not None, output
    assert int(found[1]) > 0, output


async def test_mcap_record(gateway: Gateway, examples: Path, tmp_path: Path) -> None:
    file = tmp_path / "record.mcap"
    words = ["mcap-record", "--no-compression", "-o", str(file), gateway.foxglove]
    async with publishing(gateway.environment, "/recorded"), run_example(examples, *words) as example:
        await received(gateway, example, "/recorded")
        await example.finish(signal.SIGINT)
    recorded = file.read_bytes()
    assert b"std_msgs/msg/String" in recorded
    assert b"\0\1\0\0\x09\0\0\0recorded\0" in recorded


async def received(gateway: Gateway, example: Example, topic: str) -> None:
    """Wait until an example subscribes to a topic and has read as much as thirty messages.

    The examples show what they have received at their end only.
    """
    async with asyncio.timeout(WAIT):
        while not await has_subscribers(gateway, topic):  # noqa: ASYNC110  # a graph has no event
            await asyncio.sleep(0.2)
    before = example.bytes_read()
    await until(lambda: example.bytes_read() > before + 30 * MESSAGE_SIZE, what=f"messages of {topic}")


async def has_subscribers(gateway: Gateway, topic: str) -> bool:
    listed = json.loads(await rce("topic", "list", gateway.environment.tag, "--json", env=gateway.env))
    return any(each["name"] == topic and each["subscribers"] for each in listed)
