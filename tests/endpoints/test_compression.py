"""Robots that ask for deflated messages."""

from __future__ import annotations

from contextlib import suppress

from platforms import Platform
from raw_robot import Robot, dm, status
from websockets.exceptions import ConnectionClosed

LONG = "so many words " * 10_000


def deflates(robot: Robot) -> bool:
    return bool(robot.socket.protocol.extensions)


async def test_only_who_asks_gets_it_and_messages_pass_both_ways(platform: Platform) -> None:
    asks = await platform.robot("asks", compress="deflate", compression="deflate")
    offers = await platform.robot("offers", compression="deflate")  # as every browser does
    assert (deflates(asks), deflates(offers)) == (True, False)
    await asks.add("out", "SubscriberConverter")
    await asks.add("in", "PublisherConverter", of="offers")  # by the same robot: its commands run in their order
    await asks.connect("asks/out", "offers/in")
    assert await asks.take() == status("out", True)
    assert await offers.take() == status("in", True)
    await asks.data("out", {"data": LONG})
    assert await offers.take() == dm("in", {"data": LONG})
    await asks.add("blob_in", "PublisherForwarder")
    await asks.add("blob_out", "SubscriberForwarder", of="offers")
    await asks.connect("asks/blob_in", "offers/blob_out")
    assert await asks.take() == status("blob_in", True)
    assert await offers.take() == status("blob_out", True)
    name = "a" * 32
    await offers.send(
        {"type": "DM", "data": {"iTag": "blob_out", "type": "std_msgs/String", "msgID": "1", "msg*": name}},
        name.encode() + LONG.encode(),
    )
    frame = await asks.take()
    assert (await asks.take())[32:] == LONG.encode()
    assert frame["data"]["iTag"] == "blob_in"


async def test_a_bomb_closes_the_socket(platform: Platform) -> None:
    robot = await platform.robot("bomber", compress="deflate", compression="deflate")
    other = await platform.robot("other")
    with suppress(ConnectionClosed):
        await robot.send(bytes(100_000_000))  # its extension deflates it
    code, _ = await robot.closed()
    assert code in (1006, 1009)
    await other.silent()
