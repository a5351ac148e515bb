"""Environments that take processes which were started before."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from tests.support.e2e.real_platform import RealPlatform, until


def waiting_node(platform: RealPlatform) -> int:
    """Return the pid of the interpreter beside a prepared environment, or 0."""
    engine = platform.pid(" -m containers")
    found = [node for endpoint in children(engine) for node in children(endpoint)]
    return found[0] if found else 0


def children(pid: int) -> list[int]:
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()] if pid else []


async def test_node_continues_a_prepared_process_and_gets_one_of_its_own_after_a_kill(
    arguments: list[str], tmp_path: Path
) -> None:
    async with RealPlatform(tmp_path, *arguments, "--warm", "1") as platform:
        await until(lambda: waiting_node(platform), what="a prepared process")
        prepared = waiting_node(platform)
        async with platform.robot("r2d2") as robot, robot.environment("place") as place:
            await place.add_node("echo", "rce_demo", "echo", args="--ros-args -r /say:=talk", restart="always")
            say = await place.publisher("/talk", "std_msgs/String")
            heard = await place.subscriber("/heard", "std_msgs/String")
            await say.publish({"data": "at once"})
            assert (await heard.get(30))["data"] == "at once"
            os.kill(prepared, signal.SIGKILL)
            await until(lambda: platform.pid("--enclave /echo"), what="the next process of the node")
            await say.publish({"data": "again"})
            assert (await heard.get(30))["data"] == "again"
