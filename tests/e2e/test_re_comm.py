"""RoboEarth's ROS services in an environment of a real platform."""

from __future__ import annotations

import asyncio
from typing import Any

from rce.client.knowledge import KnowledgeClient
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.knowledge import CUP

WAIT = 60.0  # seconds
MODEL = [(number % 256) - 128 for number in range(300_000)]  # more than one piece


async def test_program_for_roboearth_uses_the_repository_of_the_platform(platform: RealPlatform) -> None:
    async with platform.robot("earth") as robot, robot.environment("re_comm", restart="no") as environment:
        await environment.add_node("re_comm", "rce_knowledge", "re_comm")

        async def call(name: str, kind: str, **fields: Any) -> Any:
            service = await environment.service_client(f"/re_comm/{name}", f"re_srvs/{kind}")
            answer = await service.call(fields, WAIT)
            await service.close()
            return answer

        new = {"cls": "Cup", "id": "earthen", "description": "a cup", "object": CUP, "apiKey": "any"}
        files = [{"name": "cup.stl", "data": MODEL}]
        assert (await call("set_object", "SetObject", files=files, **new))["success"]
        client = KnowledgeClient(platform.url, user=USER, password=USER)
        entry = await asyncio.to_thread(client.get, "object", "cup.earthen")
        assert (entry.author, entry.public, [file.size for file in entry.files]) == (USER, True, [len(MODEL)])
        found = await call("search_objects", "SearchObjects", searchID="cup.earth")
        assert (found["uids"], found["objects"]) == (["cup.earthen"], [CUP])
        got = await call("get_object_binary_file", "GetObjectBinaryFile", objectUID="cup.earthen", filename="cup.stl")
        assert list(got["file"]["data"]) == MODEL
        assert (await call("del_object", "DelObject", objectUID="cup.earthen", apiKey="any"))["success"]
        assert not (await call("get_object", "GetObject", objectUID="cup.earthen"))["success"]
