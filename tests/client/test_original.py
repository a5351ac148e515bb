"""The client at a server that knows no features: the frames of the original's clients, and nothing else."""

from __future__ import annotations

import pytest
from client_contract import SET_BOOL, STRING
from fake_platform import FakePlatform

from rce.client import Reconnected, Robot
from rce.errors import InvalidRequest, NotConnected, TimedOut
from rce.messages import Qos


def robot(server: FakePlatform, name: str = "bot1") -> Robot:
    return Robot(server.url, user="testUser", robot=name, password="testUser", timeout=10)


async def test_the_frames_are_those_of_the_original_client(original: FakePlatform) -> None:
    async with robot(original) as bot:
        assert bot.features == frozenset()
        await bot.create_environment("c1")
        await bot.set_parameter("c1", "int", 99)
        await bot.add_node("c1", "echo", "Test", "stringEcho.py")
        await bot.add_interface("c1", "req", "PublisherInterface", STRING, addr="stringEchoReq")
        request = await bot.publisher("req", STRING, to="c1/req")
        await request.publish({"data": "hello"})
        await bot.delete_parameter("c1", "int")
        await bot.destroy_environment("c1")
        peer = original.peers["bot1"]
    assert peer.frames == [
        {"type": "CC", "data": {"containerTag": "c1", "containerData": {"size": 1}}},
        {"type": "CN", "data": {"setParam": [{"containerTag": "c1", "name": "int", "value": 99}]}},
        {
            "type": "CN",
            "data": {"addNodes": [{"containerTag": "c1", "nodeTag": "echo", "pkg": "Test", "exe": "stringEcho.py"}]},
        },
        {
            "type": "CN",
            "data": {
                "addInterfaces": [
                    {
                        "endpointTag": "c1",
                        "interfaceTag": "req",
                        "interfaceType": "PublisherInterface",
                        "className": STRING,
                        "addr": "stringEchoReq",
                    }
                ]
            },
        },
        {
            "type": "CN",
            "data": {
                "addInterfaces": [
                    {
                        "endpointTag": "bot1",
                        "interfaceTag": "req",
                        "interfaceType": "SubscriberConverter",
                        "className": STRING,
                    }
                ]
            },
        },
        {"type": "CX", "data": {"connect": [{"tagA": "c1/req", "tagB": "bot1/req"}]}},
        {"type": "DM", "data": {"iTag": "req", "type": STRING, "msgID": "nil", "msg": {"data": "hello"}}},
        {"type": "CN", "data": {"deleteParam": [{"containerTag": "c1", "name": "int"}]}},
        {"type": "DC", "data": {"containerTag": "c1"}},
    ]


async def test_values_that_are_false_are_sent_and_additions_only_if_asked_for(original: FakePlatform) -> None:
    async with robot(original) as bot:
        await bot.set_parameter("c1", "flag", False)
        await bot.add_interface("c1", "map", "SubscriberInterface", STRING, addr="/map", qos=Qos(depth=1))
        first, second = original.peers["bot1"].frames
    assert first["data"]["setParam"][0]["value"] is False
    assert second["data"]["addInterfaces"][0]["qos"] == {"depth": 1}


async def test_commands_end_when_sent_and_errors_are_events(original: FakePlatform) -> None:
    async with robot(original) as bot:
        events = bot.events()
        await bot.destroy_environment("nothing")
        assert "does not exist" in str(await events.get(10))
        await original.send_raw("bot1", '{"type":"ER","data":"Invalid Request: what"}')
        assert isinstance(await events.get(10), InvalidRequest)


async def test_status_gates_publishing(original: FakePlatform) -> None:
    async with robot(original) as bot:
        said = await bot.publisher("said", STRING)
        with pytest.raises(NotConnected):
            await said.publish({"data": "x"}, timeout=0.01)
        heard = await bot.subscriber("heard", STRING, to="bot1/said")
        await said.publish({"data": "x"})
        assert await heard.get(10) == {"data": "x"}


async def test_blobs_go_whole(original: FakePlatform) -> None:
    async with robot(original) as bot:
        said = await bot.publisher("said", STRING, raw=True)
        heard = await bot.subscriber("heard", STRING, to="bot1/said", raw=True)
        payload = bytes(range(256)) * 4000
        await said.publish(payload)
        assert await heard.get(10) == payload
        assert original.kinds[-1] == "part"
        assert original.kinds.count("part") == 1


async def test_services_work_and_a_failure_is_a_time_out(original: FakePlatform) -> None:
    async with robot(original) as bot, robot(original, "other") as other:

        def handler(request: dict[str, bool]) -> dict[str, bool]:
            if not request["data"]:
                raise ValueError("no")
            return {"success": True}

        await other.service_provider("serve", SET_BOOL, handler)
        client = await bot.service_client("call", SET_BOOL, to="other/serve")
        assert await client.call({"data": True}) == {"success": True}
        with pytest.raises(TimedOut):
            await client.call({"data": False}, timeout=0.05)
        assert all("id" not in frame for frame in original.peers["bot1"].frames)


async def test_a_robot_that_lost_its_socket_declares_everything_again(original: FakePlatform) -> None:
    async with robot(original) as bot:
        said = await bot.publisher("said", STRING)
        heard = await bot.subscriber("heard", STRING, to="bot1/said")
        events = bot.events()
        await original.forget("bot1")
        await events.get(10)
        assert await events.get(10) == Reconnected(resumed=False)
        await said.publish({"data": "again"})
        assert await heard.get(10) == {"data": "again"}
