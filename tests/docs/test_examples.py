"""The programs of docs/examples, each run as its header says, and programs of other pages."""

from __future__ import annotations

import asyncio
import functools
import hashlib
import json
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from rce.client import Robot, Subscriber
from rce.errors import NotFound
from tests.support.domains import domain
from tests.support.e2e.chromium import chromium, open_page, visit
from tests.support.e2e.real_platform import RCE, USER, RealPlatform
from tests.support.paths import ROOT
from tests.support.programs import running

pytestmark = pytest.mark.e2e
EXAMPLES = ROOT / "docs" / "examples"
TIMEOUT = 60.0


class Program:
    """A running example, whose output is read line by line."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._lines: list[str] = []

    async def line(self, pattern: str) -> str:
        """Return the next line of output that matches."""
        assert self._process.stdout is not None
        async with asyncio.timeout(TIMEOUT):
            while text := (await self._process.stdout.readline()).decode():
                self._lines.append(text)
                if re.search(pattern, text):
                    return text.strip()
        raise AssertionError(f"the program ended without a line like {pattern!r}:\n{''.join(self._lines)}")

    def write(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")

    async def output(self) -> list[str]:
        """Return the remaining lines once the program has ended with status 0."""
        out, _ = await asyncio.wait_for(self._process.communicate(), TIMEOUT)
        lines = out.decode().splitlines()
        assert self._process.returncode == 0, "\n".join([*self._lines, *lines])
        return lines

    async def interrupt(self) -> None:
        """End the program as Ctrl-C does; its status must be 0."""
        self._process.send_signal(signal.SIGINT)
        await self.output()


@asynccontextmanager
async def started(*command: str, **variables: str) -> AsyncIterator[Program]:
    pipe = asyncio.subprocess.PIPE
    async with running(
        *command, env=os.environ | variables, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=asyncio.subprocess.STDOUT
    ) as process:
        yield Program(process)


def example(name: str, *arguments: str, **variables: str) -> AbstractAsyncContextManager[Program]:
    return started(sys.executable, str(EXAMPLES / name), *arguments, **variables)


async def output_of(name: str, *arguments: str) -> list[str]:
    async with example(name, *arguments) as program:
        return await program.output()


async def test_topic(platform: RealPlatform) -> None:
    assert await output_of("topic.py", platform.url) == ["hello 0", "hello 1", "hello 2"]


async def test_service(platform: RealPlatform) -> None:
    parameters, light = await output_of("service.py", platform.url)
    assert "use_sim_time" in parameters
    assert light == "light on"


async def test_image(platform: RealPlatform) -> None:
    pytest.importorskip("PIL", reason="needs Pillow: pip install '.[images]'")
    assert await output_of("image.py", platform.url) == ["received 640 x 480 pixels; the first is [255, 0, 0]"]


async def test_custom_type(platform: RealPlatform) -> None:
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler for the type of the package weather: install g++ to run this")
    push = (RCE, "package", "push", str(EXAMPLES / "weather"), "--url", platform.url)
    async with started(*push, RCE_PASSWORD=USER) as program:
        await program.output()
    assert await output_of("custom_type.py", platform.url) == [
        "mean at roof: 10.0",
        "mean at roof: 15.0",
        "mean at roof: 20.0",
    ]


async def test_data_engine(platform: RealPlatform, tmp_path: Path) -> None:
    pytest.importorskip("psycopg", reason="needs psycopg: pip install '.[postgresql]'")
    database = os.environ.get("RCE_TEST_POSTGRES", "")
    if not database:
        pytest.skip("set RCE_TEST_POSTGRES to the SQLAlchemy URL of a PostgreSQL database for tests")
    place = ("--url", platform.url, "--user", USER)
    secret = tmp_path / "database"
    secret.write_text(database.replace("+psycopg", ""))
    async with started(RCE, "secret", "set", "database", "--file", str(secret), *place, RCE_PASSWORD=USER) as program:
        await program.output()
    async with started(RCE, "service", "publish", str(EXAMPLES / "data_engine"), *place, RCE_PASSWORD=USER) as program:
        assert await program.output() == [f"{USER}/data_engine: for everybody"]
    assert await output_of("data_engine.py", platform.url) == ["the cup is at 1.5, -2.0"]


async def test_two_robots(platform: RealPlatform) -> None:
    async with (
        example("two_robots.py", "lander", platform.url) as lander,
        example("two_robots.py", "rover", platform.url) as rover,
    ):
        assert await rover.output() == []
        assert await lander.output() == [f"the rover is at x = {number * 0.5:.1f}" for number in range(5)]


async def test_action(platform: RealPlatform) -> None:
    async with example("action.py", platform.url) as program:
        *feedback, result, stopped, canceled = await program.output()
    assert feedback[-1] == "so far: [0, 1, 1, 2, 3, 5]"
    assert (result, stopped, canceled) == ("succeeded: [0, 1, 1, 2, 3, 5]", "the worker stops", "canceled")


async def test_board(platform: RealPlatform, tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: install gcc to run this")
    board = str(tmp_path / "board")
    build = (compiler, "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o", board, str(EXAMPLES / "board.c"))
    async with started(*build) as program:
        assert await program.output() == []
    async with Robot(platform.url, user=USER, robot="desk", password=USER) as desk:
        assert desk.connection is not None
        address = urlsplit(desk.connection.endpoint)
        words = (str(address.hostname), str(address.port), hashlib.sha256(USER.encode()).hexdigest())
        async with started(board, *words) as program:
            await program.line("connected")
            temperatures = await find(desk, "temperature", "std_msgs/Float64", "board/temperature")
            light = await desk.publisher("light", "std_msgs/Bool", to="board/light")
            first, second = [(await temperatures.get(timeout=TIMEOUT))["data"] for _ in range(2)]
            assert second == first + 0.25
            for switch, shown in ((True, "light on"), (False, "light off")):
                await light.publish({"data": switch})
                assert await program.line("light") == shown
    async with started(board, *words[:2], "0" * 64) as program:
        assert "401" in await program.line("board:")


async def find(robot: Robot, tag: str, type_name: str, to: str) -> Subscriber:
    """Subscribe to another robot's interface as soon as it is there."""
    async with asyncio.timeout(TIMEOUT):
        while True:
            try:
                return await robot.subscriber(tag, type_name, to=to)
            except NotFound:
                await asyncio.sleep(0.05)


async def test_serve_drink(platform: RealPlatform) -> None:
    recipe, *lines = await output_of("serve_drink.py", platform.url)
    assert recipe == "recipe serve_drink.apartment: take the drink, then put it on the table"
    assert lines[0] == "the robot knows where it is"
    errors = [float(re.split(r": | m ", line)[1]) for line in lines[1:]]
    assert len(errors) == 2
    assert max(errors) < 0.3  # metres from the places, by the simulation's truth


async def test_group(platform: RealPlatform) -> None:
    assert await output_of("group.py", platform.url) == ["hello from the other environment"]


async def test_bridge(platform: RealPlatform, tmp_path: Path) -> None:
    config = tmp_path / "bridge.yaml"
    config.write_text((EXAMPLES / "bridge.yaml").read_text().replace("http://127.0.0.1:9000/", platform.url))
    variables = {"ROS_DOMAIN_ID": str(domain("example")), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    async with (
        started(RCE, "bridge", str(config), **variables) as bridge,
        example("bridge_node.py", **variables) as node,
    ):
        assert await node.output() == ["heard: hello cloud"] * 3
        await bridge.interrupt()


async def test_reconnect(platform: RealPlatform) -> None:
    async with example("reconnect.py", platform.url) as program:
        await program.line("published 5")
        platform.kill(platform.pid("endpoints.robot"))
        assert (await program.line("disconnected")).startswith("disconnected:")
        await program.line("reconnected")
        assert len(await program.output()) >= 19


async def test_blocking(platform: RealPlatform) -> None:
    assert await output_of("blocking.py", platform.url) == ["hello without asyncio"]


@pytest.fixture
def checkout_url() -> Iterator[str]:
    """URL of a web server for the checkout."""
    handler = functools.partial(QuietHandler, directory=str(ROOT))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://localhost:{server.server_port}"
        server.shutdown()
        thread.join()


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


async def test_browser(platform: RealPlatform, checkout_url: str) -> None:
    async with chromium() as browser, open_page(browser) as (page, errors):
        await visit(page, f"{checkout_url}/docs/examples/browser.html?url={platform.url}")
        await page.get_by_role("button", name="Say").click()
        await page.get_by_text("hello from a page", exact=True).wait_for()
        errors[:] = [error for error in errors if "favicon" not in error]
    async with platform.robot("cleaner") as robot:
        await robot.destroy_environment("browser_example")


async def test_first_robot_of_the_readme(platform: RealPlatform, tmp_path: Path) -> None:
    program = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert program
    file = tmp_path / "robot.py"
    file.write_text(program[1].replace("http://127.0.0.1:9000/", platform.url))
    async with started(sys.executable, str(file)) as robot:
        assert await robot.output() == ["{'data': 'hello cloud'}"]


async def test_robot_file_of_its_page(platform: RealPlatform, tmp_path: Path) -> None:
    page = (ROOT / "docs" / "robot-file.md").read_text()
    found = re.search(r"```yaml\n(.*?)```", page, re.S)
    assert found
    file = tmp_path / "robot.yaml"
    file.write_text(found[1].replace("http://127.0.0.1:9000/", platform.url))
    line_in, line_out = ('{"iTag": "say", "msg": {"data": "hi"}}', '{"iTag": "heard", "type": "std_msgs/String"')
    assert line_in in page
    assert line_out in page
    async with started(RCE, "run", str(file)) as robot:
        await robot.line("is running")
        answer = asyncio.create_task(robot.line('"heard"'))
        while not answer.done():  # the node and the interface may not have discovered each other at first
            robot.write(line_in)
            await asyncio.wait([answer], timeout=1)
        assert json.loads(answer.result()) == {"iTag": "heard", "type": "std_msgs/String", "msg": {"data": "hi"}}
        await robot.interrupt()


def test_each_example_has_a_test_and_a_header() -> None:
    tests = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    programs = {path.stem for path in EXAMPLES.iterdir() if path.suffix in {".py", ".html", ".yaml"}}
    assert programs - {"bridge_node"} <= tests
    files = [path for path in EXAMPLES.iterdir() if path.is_file() and path.stem in programs]
    assert all(re.search("Run it .*beside", path.read_text()) for path in files)
