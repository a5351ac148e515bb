"""Clients of rosbridge as they are published, at the gateway of a real platform through `rce gateway`."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import cbor2
import numpy as np
import pytest
from websockets.asyncio.client import connect

pytest.importorskip("DracoPy", reason="needs DracoPy: pip install '.[draco]'")

import DracoPy

from tests.support.e2e.chromium import chromium, open_page
from tests.support.e2e.foreign_suites import node_modules, source_distribution
from tests.support.e2e.gateways import CLOUD, Gateway, open_gateway, publish_camera_and_cloud
from tests.support.e2e.node import node_command
from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import TESTS

SCRIPT = TESTS / "js" / "roslib_operations.mjs"
PORT = 9090  # which the suite of roslibpy has in its code
MODULES = ("bson@7.2.0", "cbor2@2.2.1", "eventemitter3@5.0.4", "fast-png@8.0.0", "uuid@13.0.0", "ws@8.19.0")
IMPORTS = {
    "roslib": "roslib/dist/RosLib.js",
    "bson": "bson/lib/bson.mjs",
    "cbor2": "cbor2/lib/index.js",
    "eventemitter3": "eventemitter3/dist/eventemitter3.esm.js",
    "fast-png": "fast-png/lib/index.js",
    "uuid": "uuid/dist/index.js",
    "ws": "ws/browser.js",
    "@cto.af/wtf8": "@cto.af/wtf8/lib/index.js",
    "fflate": "fflate/esm/browser.js",
    "iobuffer": "iobuffer/lib/iobuffer.js",
}


@pytest.fixture(scope="module")
async def gateway(platform: RealPlatform, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Gateway]:
    with socket.socket() as probe:
        port = 0 if probe.connect_ex(("127.0.0.1", PORT)) == 0 else PORT
    async with open_gateway(platform, tmp_path_factory.mktemp("home"), "bridged", port) as gateway:
        yield gateway


@pytest.fixture(scope="module")
def roslibpy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return source_distribution(tmp_path_factory.mktemp("roslibpy"), "roslibpy", "2.1.0")


@pytest.fixture(scope="module")
def roslib(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return node_modules(tmp_path_factory.mktemp("roslib"), "roslib@2.1.0", *MODULES)


async def run(*words: str, cwd: Path, **environ: str) -> str:
    """Run a program and return what it prints; it must succeed within three minutes."""
    process = await asyncio.create_subprocess_exec(
        *words, cwd=cwd, env=os.environ | environ, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert process.stdout is not None
    output = b""
    try:
        async with asyncio.timeout(180):
            while chunk := await process.stdout.read(65536):
                output += chunk
            await process.wait()
    except TimeoutError:
        raise AssertionError(f"{words} does not end:\n{output.decode()}") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode == 0, output.decode()
    return output.decode()


async def test_client_gets_packets_of_a_cloud(gateway: Gateway) -> None:
    publishing = asyncio.create_task(publish_camera_and_cloud(gateway.environment))
    wish = {"op": "subscribe", "topic": "/cloud", "type": CLOUD, "codec": "draco", "compression": "cbor"}
    try:
        async with connect(gateway.rosbridge) as client, asyncio.timeout(60):
            await client.send(json.dumps(wish))
            packet = cbor2.loads(await client.recv(decode=False))["msg"]
    finally:
        publishing.cancel()
        await asyncio.gather(publishing, return_exceptions=True)
    assert (packet["header"]["frame_id"], packet["width"]) == ("map", 2)
    points = DracoPy.decode(packet["data"]).points
    assert np.abs(np.sort(points, axis=0) - [[1, 2, 3], [4, 5, 6]]).max() < 0.01


@pytest.mark.parametrize("transport", ["twisted", "asyncio"])
async def test_suite_of_roslibpy_passes(gateway: Gateway, roslibpy: Path, transport: str) -> None:
    if not gateway.rosbridge.endswith(f":{PORT}"):
        pytest.skip(f"port {PORT}, which the suite of roslibpy has in its code, is in use")
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/ros2"]
    output = await run(*words, cwd=roslibpy, PYTHONPATH=str(roslibpy / "src"), ROSLIBPY_TRANSPORT=transport)
    assert "25 passed" in output
    assert "skipped" not in output


async def test_every_operation_of_roslib(gateway: Gateway, roslib: Path) -> None:
    output = await run(*node_command(), str(SCRIPT), gateway.rosbridge, str(roslib), cwd=roslib)
    assert output.endswith("all ok\n"), output


PAGE = """
<link rel="icon" href="data:,">
<script type="importmap">IMPORTS</script>
<p id="topic"></p><p id="service"></p><p id="action"></p>
<script type="module">
  import * as ROSLIB from "roslib";
  const show = (id, value) => { document.getElementById(id).textContent = JSON.stringify(value); };
  const ros = new ROSLIB.Ros({ url: "URL" });
  ros.on("connection", () => {
    const topic = { ros, name: "/page_speed", messageType: "geometry_msgs/Twist" };
    new ROSLIB.Topic(topic).subscribe((message) => show("topic", message.linear.x));
    const out = new ROSLIB.Topic(topic);
    let speed = 0;
    setInterval(() => out.publish({ linear: { x: (speed += 1) } }), 100);
    const service = { ros, name: "/example_fibonacci/get_parameters", serviceType: "rcl_interfaces/GetParameters" };
    const parameters = new ROSLIB.Service(service);
    // The first answer of a node is lost if DDS discovery has not finished.
    const ask = () => parameters.callService(
      { names: ["use_sim_time"] }, (answer) => show("service", answer.values[0].type), () => setTimeout(ask, 100));
    ask();
    const action = new ROSLIB.Action({ ros, name: "/fibonacci", actionType: "example_interfaces/Fibonacci" });
    action.sendGoal({ order: 3 }, (result) => show("action", result.sequence));
  });
</script>
"""


@contextmanager
def served(directory: Path) -> Iterator[str]:
    """Serve a directory; yield its URL. Chromium lets no page that is routed connect to loopback."""

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(directory))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


async def test_page_shows_a_topic_calls_a_service_and_sends_a_goal(gateway: Gateway, roslib: Path) -> None:
    imports = ", ".join(f'"{name}": "/{path}"' for name, path in IMPORTS.items())
    body = PAGE.replace("IMPORTS", f'{{"imports": {{{imports}}}}}').replace("URL", gateway.rosbridge)
    (roslib / "index.html").write_text(body)
    with served(roslib) as url:
        async with chromium() as browser, open_page(browser) as (page, _):
            await page.goto(url)
            await page.wait_for_function("Number(document.getElementById('topic').textContent) > 5")
            await page.wait_for_function("document.getElementById('service').textContent === '1'")
            await page.wait_for_function("document.getElementById('action').textContent === '[0,1,1,2]'")
