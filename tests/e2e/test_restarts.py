"""Robot programs that are killed and started again at once."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

from tests.support.e2e.consoles import rce, user_environ
from tests.support.e2e.real_platform import RCE, USER, RealPlatform
from tests.support.paths import ROOT
from tests.support.programs import running

WAIT, PATIENCE = 120.0, 20.0  # seconds
PROGRAM = re.compile(r"```python\n(import asyncio\nfrom rce\.client import Robot\n.*?)```", re.DOTALL)
FILE = {
    "userID": USER,
    "robotID": "restarted_file",
    "password": USER,
    "containers": [{"cTag": "restarted_voice"}],
    "parameters": [{"cTag": "restarted_voice", "name": "rate", "value": 10}],
    "nodes": [{"cTag": "restarted_voice", "nTag": "echo", "pkg": "rce_demo", "exe": "echo"}],
    "interfaces": [
        {
            "eTag": "restarted_voice",
            "iTag": "say",
            "iType": "PublisherInterface",
            "iCls": "std_msgs/String",
            "addr": "/say",
        },
        {"eTag": "restarted_file", "iTag": "say", "iType": "SubscriberConverter", "iCls": "std_msgs/String"},
    ],
    "connections": [{"tagA": "restarted_file/say", "tagB": "restarted_voice/say"}],
}


def started(*words: str) -> AbstractAsyncContextManager[asyncio.subprocess.Process]:
    return running(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


async def test_first_program_of_the_readme_runs_again_after_it_was_killed(
    platform: RealPlatform, tmp_path: Path
) -> None:
    (text,) = PROGRAM.findall((ROOT / "README.md").read_text())
    text = text.replace("http://127.0.0.1:9000/", platform.url).replace('"brain"', '"restarted"')
    endless = tmp_path / "endless.py"
    endless.write_text(
        text.replace("print(await listen.get())", "print(await listen.get(), flush=True); await asyncio.sleep(600)")
    )
    for delay in (0.5, 1.0, 0.0, 0.0):  # without a delay it is killed when it has heard the message
        async with started(sys.executable, str(endless)) as process:
            assert process.stdout is not None
            reading = asyncio.create_task(process.stdout.readline())
            if delay:
                await asyncio.wait([reading], timeout=delay)
            else:
                await heard(platform, reading)
                assert "hello cloud" in (await reading).decode()
    (tmp_path / "once.py").write_text(text)
    async with started(sys.executable, str(tmp_path / "once.py")) as process:
        ending = asyncio.create_task(process.communicate())
        await heard(platform, ending)
        out, err = await ending
    assert (process.returncode, out) == (0, b"{'data': 'hello cloud'}\n"), err.decode()


async def heard(platform: RealPlatform, task: asyncio.Task[Any]) -> None:
    """Wait for a task that ends when the program has heard its message.

    The only answer of its node is lost if DDS discovery takes too long: after a while another robot sends the message.
    """
    async with asyncio.timeout(WAIT):
        await asyncio.wait([task], timeout=PATIENCE)
        if task.done():
            return
        async with platform.robot("restarted_helper") as robot:
            publisher = await robot.environment("restarted").publisher("/say", "std_msgs/String")
            while not task.done():
                publisher.offer({"data": "hello cloud"})
                await asyncio.wait([task], timeout=1)


async def test_robot_file_runs_again_after_it_was_killed(platform: RealPlatform, tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    env = user_environ(tmp_path, platform.url)
    for arguments in ("", "", "--ros-args --log-level debug"):
        FILE["nodes"][0]["args"] = arguments  # type: ignore[index]  # a list of dicts
        path.write_text(json.dumps(FILE | {"url": platform.url}))
        async with started(RCE, "run", str(path)) as process:
            assert process.stderr is not None
            async with asyncio.timeout(WAIT):
                lines = [line async for line in _until(process.stderr, b"is running")]
            assert lines
            assert arguments in await rce("node", "show", "restarted_voice", "echo", env=env)
    await rce("env", "delete", "restarted_voice", env=env)


async def _until(stream: asyncio.StreamReader, word: bytes) -> AsyncIterator[bytes]:
    """Yield the lines of a stream up to the one that has a word."""
    async for line in stream:
        yield line
        if word in line:
            return
    raise AssertionError("the program ended")
