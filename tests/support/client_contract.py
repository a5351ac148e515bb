"""Contract tests of the client library for any platform with features.

A test class inherits `ClientContract` and provides the fixture `platform`. The tests use robots only, no environments,
and messages of common types.
"""

from __future__ import annotations

import asyncio
import itertools
import random
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import pytest

from rce.client import Disconnected, Reconnected, Robot
from rce.client.backlog import Offline
from rce.client.events import Event
from rce.client.stream import Stream
from rce.errors import (
    AlreadyExists,
    NotConnectable,
    NotConnected,
    NotFound,
    RceError,
    TimedOut,
    Unavailable,
)
from rce.protocol.blobs import PART
from rce.protocol.messages import AddInterface, Connect, ConnectionEvent, Delivery, Qos

WAIT = 60.0  # seconds; a limit that only ends a test that hangs
STRING, POSE, SET_BOOL = "std_msgs/String", "geometry_msgs/Pose2D", "std_srvs/SetBool"


class Platform(ABC):
    """Running platform with the user `testUser`."""

    @abstractmethod
    def robot(self, name: str) -> Robot:
        """Return a robot of that user, not connected yet, whose commands time out after 60 s at most."""

    @abstractmethod
    def break_socket(self, robot: str) -> None:
        """Break the robot's socket without a closing handshake; its session is kept."""

    @abstractmethod
    async def end_session(self, robot: str) -> None:
        """Break the robot's socket and end its session at once."""


async def until(condition: Callable[[], bool]) -> None:
    """Run the event loop until the condition holds, for WAIT seconds at most."""
    async with asyncio.timeout(WAIT):
        while not condition():  # noqa: ASYNC110  # the condition has no event to wait for
            await asyncio.sleep(0)


async def state_of_connection(events: Stream[Event]) -> str:
    """Return what the next event about a connection reports."""
    while True:
        event = await events.get(WAIT)
        if isinstance(event, ConnectionEvent):
            return event.state


class ClientContract:
    """Tests that every platform with features must pass."""

    async def test_message_is_delivered(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", POSE)
            publisher = await a.publisher("out", POSE, to="b/in")
            await publisher.publish({"x": 1.5, "y": -2.0, "theta": 0.5})
            assert await subscriber.get(WAIT) == {"x": 1.5, "y": -2.0, "theta": 0.5}
            assert subscriber.connected

    async def test_callback_gets_each_message_once_in_order(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            received: list[str] = []
            done = asyncio.Event()

            async def callback(message: dict[str, str]) -> None:
                received.append(message["data"])
                if message["data"] == "99":
                    done.set()
                if message["data"] == "50":
                    raise ValueError("the callback must be called for the next message all the same")

            await b.subscriber("in", STRING, callback=callback, depth=100)
            publisher = await a.publisher("out", STRING, to="b/in")
            for number in range(100):
                await publisher.publish({"data": str(number)})
            await asyncio.wait_for(done.wait(), WAIT)
            assert received == [str(number) for number in range(100)]

    async def test_raw_bytes_of_any_size_arrive_unchanged(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING, raw=True)
            publisher = await a.publisher("out", STRING, to="b/in", raw=True)
            for size in (1, 1000, PART, 3 * PART + 1):
                payload = random.randbytes(size)
                await publisher.publish(payload)
                assert await subscriber.get(WAIT) == payload

    async def test_small_message_overtakes_large_one(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            order: list[str] = []
            done = asyncio.Event()

            def image(message: bytes) -> None:
                order.append("large")
                done.set()

            await b.subscriber("images", STRING, raw=True, callback=image)
            await b.subscriber("velocities", POSE, callback=lambda message: order.append("small"))
            images = await a.publisher("images", STRING, to="b/images", raw=True)
            velocities = await a.publisher("velocities", POSE, to="b/velocities")
            await images.publish(bytes(20_000_000))
            await velocities.publish({"x": 1.0})
            await asyncio.wait_for(done.wait(), WAIT)
            assert order == ["small", "large"]

    async def test_service_responses_and_errors(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:

            async def set_bool(request: dict[str, bool]) -> dict[str, Any]:
                if not request["data"]:
                    raise ValueError("the gripper is stuck")
                return {"success": True, "message": "ok"}

            await b.service_provider("gripper", SET_BOOL, set_bool)
            gripper = await a.service_client("gripper", SET_BOOL, to="b/gripper")
            answers = await asyncio.gather(*(gripper.call({"data": True}) for _ in range(10)))
            assert answers == [{"success": True, "message": "ok"}] * 10
            with pytest.raises(RceError, match="the gripper is stuck"):
                await gripper.call({"data": False})

    async def test_plain_function_as_handler_and_timeout_of_slow_service(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            never = asyncio.Event()
            await b.service_provider("quick", SET_BOOL, lambda request: {"success": request["data"], "message": ""})
            await b.service_provider("slow", SET_BOOL, lambda request: never.wait())
            quick = await a.service_client("quick", SET_BOOL, to="b/quick")
            assert await quick.call({"data": True}) == {"success": True, "message": ""}
            slow = await a.service_client("slow", SET_BOOL, to="b/slow")
            with pytest.raises(TimedOut, match="slow"):
                await slow.call({"data": True}, timeout=0.05)

    async def test_failed_commands_raise(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            await a.publisher("out", STRING)
            await b.subscriber("in", POSE)
            with pytest.raises(NotFound):
                await a.connect("a/out", "b/nothing")
            with pytest.raises(NotConnectable):
                await a.connect("a/out", "b/in")
            with pytest.raises(AlreadyExists) as caught:
                await a.configure(
                    AddInterface("a", "other", "SubscriberConverter", STRING),
                    AddInterface("a", "out", "SubscriberConverter", STRING),
                )
            assert caught.value.item == "commands[1]"
            await a.remove_interface("a", "other")
            with pytest.raises(NotFound):
                await a.remove_interface("a", "other")

    async def test_interface_that_cannot_be_connected_is_removed(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            with pytest.raises(NotFound):
                await a.publisher("out", STRING, to="b/in")
            subscriber = await b.subscriber("in", STRING)
            publisher = await a.publisher("out", STRING, to="b/in")
            await publisher.publish({"data": "x"})
            assert await subscriber.get(WAIT) == {"data": "x"}

    async def test_without_peer_publish_raises_and_offer_drops(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            publisher = await a.publisher("out", STRING)
            with pytest.raises(NotConnected, match="a/out"):
                await publisher.publish({"data": "x"}, timeout=0.01)
            assert not publisher.offer({"data": "x"})
            assert publisher.dropped == 1
            subscriber = await b.subscriber("in", STRING, to="a/out")
            await publisher.wait_connected(WAIT)
            assert publisher.offer({"data": "y"})
            assert await subscriber.get(WAIT) == {"data": "y"}
            await subscriber.close()
            await until(lambda: not publisher.connected)

    @pytest.mark.parametrize(("offline", "arrive"), [("drop", []), ("newest", [2]), ("store", [0, 1, 2])])
    async def test_publisher_that_does_not_wait_keeps_what_it_should(
        self, platform: Platform, offline: Offline, arrive: list[int]
    ) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            publisher = await a.publisher("out", STRING, offline=offline)
            for number in range(3):
                await publisher.publish({"data": str(number)}, wait=False)
            assert publisher.dropped == 3 - len(arrive)
            subscriber = await b.subscriber("in", STRING, to="a/out")
            await publisher.wait_connected(WAIT)
            await publisher.publish({"data": "last"}, wait=True)
            for number in arrive:
                assert await subscriber.get(WAIT) == {"data": str(number)}
            assert await subscriber.get(WAIT) == {"data": "last"}
            for number in range(20):
                await publisher.publish({"data": str(number)}, wait=False)
                assert await subscriber.get(WAIT) == {"data": str(number)}

    async def test_old_messages_are_dropped_and_the_rate_is_kept(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING)
            old = await a.publisher("old", STRING, to="b/in", delivery=Delivery(maxAge=1e-9))
            assert old.offer({"data": "late"})
            slow = await a.publisher("slow", STRING, to="b/in", delivery=Delivery("high", rate=0.001))
            assert slow.offer({"data": "first"})
            assert not slow.offer({"data": "second"})
            assert await subscriber.get(WAIT) == {"data": "first"}
            assert (old.dropped, slow.dropped) == (1, 1)

    async def test_resumed_session_keeps_interfaces_and_connections(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING)
            publisher = await a.publisher("out", STRING, to="b/in")
            back = await b.subscriber("back", STRING)
            answer = await a.publisher("answer", STRING, to="b/back")
            for robot, name in ((a, "a"), (b, "b")):
                events = robot.events()
                platform.break_socket(name)
                assert isinstance(await events.get(WAIT), Disconnected)
                assert await events.get(WAIT) == Reconnected(resumed=True)
                await publisher.publish({"data": name})
                await answer.publish({"data": name})
                assert await subscriber.get(WAIT) == {"data": name}
                assert await back.get(WAIT) == {"data": name}

    async def test_new_session_restores_interfaces_and_connections(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING)
            await b.service_provider("serve", SET_BOOL, lambda request: {"success": True, "message": ""})
            publisher = await a.publisher("out", STRING, to="b/in")
            call = await a.service_client("call", SET_BOOL, to="b/serve")
            gone = await a.publisher("gone", STRING, to="b/in")
            await gone.close()
            events = a.events()
            await platform.end_session("a")
            assert isinstance(await events.get(WAIT), Disconnected)
            assert await events.get(WAIT) == Reconnected(resumed=False)
            await publisher.publish({"data": "again"})
            assert await subscriber.get(WAIT) == {"data": "again"}
            assert (await call.call({"data": True}))["success"]
            with pytest.raises(NotFound):
                await a.remove_interface("a", "gone")

    async def test_connection_is_back_when_the_other_robot_is(self, platform: Platform) -> None:
        async with platform.robot("a") as a:
            async with platform.robot("b") as b:
                await b.subscriber("in", STRING)
                publisher = await a.publisher("out", STRING, to="b/in")
                events = a.events()
            assert await state_of_connection(events) == "waiting"
            async with platform.robot("b") as b:
                subscriber = await b.subscriber("in", STRING)
                assert await state_of_connection(events) == "restored"
                await publisher.publish({"data": "again"})
                assert await subscriber.get(WAIT) == {"data": "again"}

    async def test_new_session_connects_when_the_other_robot_is_back(self, platform: Platform) -> None:
        async with platform.robot("a") as a:
            async with platform.robot("b") as b:
                await b.subscriber("in", STRING)
                publisher = await a.publisher("out", STRING, to="b/in")
            events = a.events()
            await platform.end_session("a")
            while not isinstance(await events.get(WAIT), NotFound):
                pass  # a was told that b/in does not exist
            async with platform.robot("b") as b:
                subscriber = await b.subscriber("in", STRING)
                await publisher.publish({"data": "again"})
                assert await subscriber.get(WAIT) == {"data": "again"}

    async def test_resumed_session_connects_when_the_other_robot_is_back(self, platform: Platform) -> None:
        async with platform.robot("a") as a:
            async with platform.robot("b") as b:
                await b.subscriber("in", STRING)
                publisher = await a.publisher("out", STRING, to="b/in")
            events = a.events()
            await platform.end_session("a")
            while not isinstance(await events.get(WAIT), NotFound):
                pass  # a was told that b/in does not exist
            platform.break_socket("a")
            while await events.get(WAIT) != Reconnected(resumed=True):
                pass
            async with platform.robot("b") as b:
                subscriber = await b.subscriber("in", STRING)
                await publisher.publish({"data": "again"})
                assert await subscriber.get(WAIT) == {"data": "again"}

    async def test_connection_to_a_removed_interface_is_gone(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING)
            await a.publisher("out", STRING, to="b/in")
            events = a.events()
            await subscriber.close()
            assert await state_of_connection(events) == "gone"

    async def test_commands_issued_while_offline_are_executed(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING)
            platform.break_socket("a")
            publisher = await a.publisher("out", STRING, to="b/in")
            await publisher.publish({"data": "x"})
            assert await subscriber.get(WAIT) == {"data": "x"}

    async def test_service_call_raises_unavailable_when_socket_breaks(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            called, never = asyncio.Event(), asyncio.Event()

            async def hang(request: dict[str, bool]) -> None:
                called.set()
                await never.wait()

            await b.service_provider("serve", SET_BOOL, hang)
            client = await a.service_client("call", SET_BOOL, to="b/serve")
            call = asyncio.create_task(client.call({"data": True}))
            await asyncio.wait_for(called.wait(), WAIT)
            events = a.events()
            platform.break_socket("a")
            with pytest.raises(Unavailable, match="not known"):
                await call
            assert isinstance(await events.get(WAIT), Disconnected)
            assert await events.get(WAIT) == Reconnected(resumed=True)

    async def test_no_message_is_delivered_twice_across_reconnections(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING, depth=10_000)
            publisher = await a.publisher("out", STRING, to="b/in")
            numbers, received = itertools.count(), []

            for _ in range(3):
                events = a.events()
                platform.break_socket("a")
                back = asyncio.create_task(anext(event async for event in events if isinstance(event, Reconnected)))
                while not back.done():
                    await publisher.publish({"data": str(next(numbers))})
                    await asyncio.sleep(0)
            last = next(numbers)
            await publisher.publish({"data": str(last)})
            async for message in subscriber:
                received.append(int(message["data"]))
                if received[-1] == last:
                    break
            assert received == sorted(set(received))

    async def test_stored_messages_arrive_once_and_in_order(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING, depth=100_000, qos=Qos(history="keep_all"))
            publisher = await a.publisher("out", STRING, to="b/in", offline="store")
            numbers, received = itertools.count(), []

            for rounds in range(5):
                events = a.events()
                for _ in range(20):
                    await publisher.publish({"data": str(next(numbers))}, wait=False)
                for _ in range(10 * rounds):
                    await asyncio.sleep(0)  # so that the socket breaks at several places
                platform.break_socket("a")
                back = asyncio.create_task(anext(event async for event in events if isinstance(event, Reconnected)))
                while not back.done():
                    await publisher.publish({"data": str(next(numbers))}, wait=False)
                    await asyncio.sleep(0.001)
            last = next(numbers)
            await publisher.publish({"data": str(last)})
            while last not in received:
                received.append(int((await subscriber.get(WAIT))["data"]))
            assert received == list(range(last + 1))
            assert publisher.dropped == 0

    async def test_close_flushes_queued_messages_and_ends_readers(self, platform: Platform) -> None:
        async with platform.robot("b") as b:
            subscriber = await b.subscriber("in", STRING, depth=100)
            async with platform.robot("a") as a:
                own = await a.subscriber("own", STRING)
                publisher = await a.publisher("out", STRING, to="b/in")
                for _ in range(20):
                    await publisher.publish({"data": "x" * 100_000})
            assert [message async for message in own] == []
            for _ in range(20):
                await subscriber.get(WAIT)
            with pytest.raises(Unavailable):
                await a.connect("a/out", "b/in")

    async def test_name_is_free_after_close(self, platform: Platform) -> None:
        for _ in range(3):
            async with platform.robot("a") as a:
                await a.publisher("out", STRING)

    async def test_name_in_use_is_rejected(self, platform: Platform) -> None:
        async with platform.robot("a"):
            with pytest.raises(AlreadyExists):
                await platform.robot("a").open(wait=0)

    async def test_restarted_robot_waits_for_its_name(self, platform: Platform) -> None:
        first, second = platform.robot("a"), platform.robot("a")
        await first.open()
        opening = asyncio.create_task(second.open())
        await first.close()
        await opening
        assert second.connected
        await second.close()

    async def test_configure_executes_commands_in_order(self, platform: Platform) -> None:
        async with platform.robot("a") as a:
            await a.configure(
                AddInterface("a", "out", "SubscriberConverter", STRING),
                AddInterface("a", "in", "PublisherConverter", STRING),
                Connect("a/out", "a/in"),
            )
            with pytest.raises(AlreadyExists):
                await a.connect("a/in", "a/out")
