"""The client at a server of the original: it sends the frames of the original's clients and no others."""

from __future__ import annotations

import pytest

from rce.client import Reconnected
from rce.errors import InvalidRequest, NotConnected, TimedOut
from rce.protocol.messages import Qos
from tests.support.client_contract import SET_BOOL, STRING
from tests.support.fake_platform import FakePlatform


async def test_frames_equal_those_of_the_original_client(original: FakePlatform) -> None:
    async with original.robot("bot1") as bot:
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


async def test_false_values_are_sent_and_extensions_only_if_set(original: FakePlatform) -> None:
    async with original.robot("bot1") as bot:
        await bot.set_parameter("c1", "flag", False)
        await bot.add_interface("c1", "map", "SubscriberInterface", STRING, addr="/map", qos=Qos(depth=1))
        first, second = original.peers["bot1"].frames
    assert first["data"]["setParam"][0]["value"] is False
    assert second["data"]["addInterfaces"][0]["qos"] == {"depth": 1}


async def test_commands_return_when_sent_and_errors_are_events(original: FakePlatform) -> None:
    async with original.robot("bot1") as bot:
        events = bot.events()
        await bot.destroy_environment("nothing")
        assert "does not exist" in str(await events.get(10))
        await original.send_raw("bot1", '{"type":"ER","data":"Invalid Request: what"}')
        assert isinstance(await events.get(10), InvalidRequest)


async def test_interface_status_enables_publishing(original: FakePlatform) -> None:
    async with original.robot("bot1") as bot:
        publisher = await bot.publisher("out", STRING)
        with pytest.raises(NotConnected):
            await publisher.publish({"data": "x"}, timeout=0.01)
        subscriber = await bot.subscriber("in", STRING, to="bot1/out")
        await publisher.publish({"data": "x"})
        assert await subscriber.get(10) == {"data": "x"}


async def test_blobs_are_sent_in_one_frame(original: FakePlatform) -> None:
    async with original.robot("bot1") as bot:
        publisher = await bot.publisher("out", STRING, raw=True)
        subscriber = await bot.subscriber("in", STRING, to="bot1/out", raw=True)
        payload = bytes(range(256)) * 4000
        await publisher.publish(payload)
        assert await subscriber.get(10) == payload
        assert original.frame_types[-1] == "part"
        assert original.frame_types.count("part") == 1


async def test_service_calls_and_timeout_of_a_failed_call(original: FakePlatform) -> None:
    async with original.robot("bot1") as bot, original.robot("other") as other:

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


async def test_reconnection_restores_interfaces_and_connections(original: FakePlatform) -> None:
    async with original.robot("bot1") as bot:
        publisher = await bot.publisher("out", STRING)
        subscriber = await bot.subscriber("in", STRING, to="bot1/out")
        events = bot.events()
        await original.end_session("bot1")
        await events.get(10)
        assert await events.get(10) == Reconnected(resumed=False)
        await publisher.publish({"data": "again"})
        assert await subscriber.get(10) == {"data": "again"}
