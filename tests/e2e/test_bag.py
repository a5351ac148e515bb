"""`rce bag`: topics of an environment are recorded, described, and played in another environment."""

from __future__ import annotations

import asyncio
import json
import time
from contextlib import suppress
from pathlib import Path

from rce.bag.reader import read, summarize
from rce.client import Publisher
from rce.client.recordings import RecordingsClient
from rce.errors import InvalidRequest
from tests.support.e2e.consoles import rce, running, user_environ
from tests.support.e2e.real_platform import USER, RealPlatform, until

STRING, POSE = "std_msgs/String", "geometry_msgs/PoseStamped"
COUNT = 50
PERIOD = 0.02  # seconds


async def speak(numbers: Publisher, pose: Publisher) -> None:
    """Publish numbered strings and a pose."""
    await pose.publish({"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}})
    for number in range(COUNT):
        await numbers.publish({"data": str(number)})
        await asyncio.sleep(PERIOD)


def counts(file: Path) -> dict[str, int]:
    """Return the numbers of messages in a recording that goes on; what waits is written once a second."""
    with suppress(InvalidRequest):  # nothing is written yet
        return summarize(file).counts
    return {}


async def test_recording_is_played_as_it_was(platform: RealPlatform, tmp_path: Path) -> None:
    file, env = tmp_path / "a.mcap", user_environ(tmp_path, platform.url)
    async with platform.robot("bagged") as robot, robot.environment("bag_source"), robot.environment("bag_target"):
        source = robot.environment("bag_source")
        numbers, pose = await source.publisher("/number", STRING), await source.publisher("/pose", POSE)
        words = ("bag", "record", "bag_source", "/number", "/pose", "--out", str(file))
        async with running(*words, env=env) as recording:
            await recording.expect_line("2 topics into")
            await speak(numbers, pose)
            await until(lambda: counts(file) == {"/number": COUNT, "/pose": 1}, what="the last message in the file")
            assert await recording.interrupt() == 0
        recorded = list(read(file))
        texts = [each.cdr for each in recorded if each.topic == "/number"]
        assert [int(text[8:].rstrip(b"\0")) for text in texts] == list(range(COUNT))
        found = json.loads(await rce("bag", "info", str(file), "--json", env=env))
        assert found["types"] == {"/number": "std_msgs/msg/String", "/pose": "geometry_msgs/msg/PoseStamped"}
        assert found["counts"] == {"/number": COUNT, "/pose": 1}
        assert found["complete"]
        heard = await robot.environment("bag_target").subscriber("/number", STRING)
        poses = await robot.environment("bag_target").subscriber("/pose", POSE)
        clock = await robot.environment("bag_target").subscriber("/clock", "rosgraph_msgs/Clock")
        before = time.time()
        await rce("bag", "play", str(file), "bag_target", "--clock", "--rate", "2", env=env)
        assert [(await heard.get(60))["data"] for _ in range(COUNT)] == [str(number) for number in range(COUNT)]
        assert (await poses.get(60))["pose"]["position"]["x"] == 1.5
        now = (await clock.get(60))["clock"]
        assert recorded[0].time <= now["sec"] * 10**9 + now["nanosec"] < before * 10**9, "the time of the recording"


async def test_topic_that_does_not_exist_is_named(platform: RealPlatform, tmp_path: Path) -> None:
    env = user_environ(tmp_path, platform.url)
    async with platform.robot("bagged") as robot, robot.environment("bag_empty"):
        words = ("bag", "record", "bag_empty", "/nuber", "--out", str(tmp_path / "b.mcap"))
        assert "there is no topic /nuber in bag_empty" in await rce(*words, env=env, status=1)


async def test_cloud_records_what_nodes_and_robots_publish(platform: RealPlatform, tmp_path: Path) -> None:
    client = RecordingsClient(platform.url, user=USER, password=USER)
    copy, env = tmp_path / "copy.mcap", user_environ(tmp_path, platform.url)
    async with platform.robot("bagged") as robot, robot.environment("bag_cloud") as cloud:
        await cloud.add_node("echo", "rce_demo", "echo")
        say = await cloud.publisher("/say", STRING)
        heard = await cloud.subscriber("/heard", STRING)
        await cloud.add_recorder("box", "/say", "/heard")
        await until(lambda: client.pages("", "bag_cloud").items, what="a recording")
        for number in range(COUNT):
            await say.publish({"data": str(number)})
            await heard.get(60)
        await cloud.remove_recorder("box")
        (found,) = (await asyncio.to_thread(client.pages, "", "bag_cloud")).items
        assert (found.state, found.recorderTag) == ("complete", "box")
        name = f"{found.machine}/{found.recording}"
        await rce("bag", "get", name, "--out", str(copy), env=env)
        counted = summarize(copy).counts
        assert set(counted) == {"/say", "/heard"}
        assert counted["/say"] > COUNT / 2  # the recorder finds a topic within a second
        uploaded = await robot.upload_recording(copy)
        await rce("bag", "remove", name, env=env)
    kept = (await asyncio.to_thread(client.pages)).items
    assert [f"{each.machine}/{each.recording}" for each in kept] == [uploaded]
