"""Robots that request compressed messages (permessage-deflate)."""

from __future__ import annotations

from contextlib import suppress

from websockets.exceptions import ConnectionClosed

from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import Robot, dm, status

LONG = "so many words " * 10_000


def deflates(robot: Robot) -> bool:
    return bool(robot.socket.protocol.extensions)


async def test_compression_is_used_only_on_request(platform: Platform) -> None:
    asks = await platform.robot("asks", compress="deflate", compression="deflate")
    offers = await platform.robot("offers", compression="deflate")  # as every browser does
    assert (deflates(asks), deflates(offers)) == (True, False)
    await asks.add("out", "SubscriberConverter")
    await asks.add("in", "PublisherConverter", of="offers")  # by the same robot, whose commands are executed in order
    await asks.connect("asks/out", "offers/in")
    assert await asks.receive() == status("out", True)
    assert await offers.receive() == status("in", True)
    await asks.data("out", {"data": LONG})
    assert await offers.receive() == dm("in", {"data": LONG})
    await asks.add("blob_in", "PublisherForwarder")
    await asks.add("blob_out", "SubscriberForwarder", of="offers")
    await asks.connect("asks/blob_in", "offers/blob_out")
    assert await asks.receive() == status("blob_in", True)
    assert await offers.receive() == status("blob_out", True)
    name = "a" * 32
    await offers.send(
        {"type": "DM", "data": {"iTag": "blob_out", "type": "std_msgs/String", "msgID": "1", "msg*": name}},
        name.encode() + LONG.encode(),
    )
    frame = await asks.receive()
    assert (await asks.receive())[32:] == LONG.encode()
    assert frame["data"]["iTag"] == "blob_in"


async def test_compression_bomb_closes_socket(platform: Platform) -> None:
    robot = await platform.robot("bomber", compress="deflate", compression="deflate")
    other = await platform.robot("other")
    with suppress(ConnectionClosed):
        await robot.send(bytes(100_000_000))  # compressed by the extension
    code, _ = await robot.closed()
    assert code in (1006, 1009)
    await other.expect_silence()
