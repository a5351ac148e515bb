"""What the client library must do at any platform with features; a test class inherits it and provides `platform`.

Robots only: the platform needs no environment, and the messages are of common types.
"""

from __future__ import annotations

import asyncio
import itertools
import random
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import pytest

from rce.blobs import PART
from rce.client import Disconnected, Reconnected, Robot
from rce.errors import (
    AlreadyExists,
    NotConnectable,
    NotConnected,
    NotFound,
    RceError,
    TimedOut,
    Unavailable,
)
from rce.messages import AddInterface, Connect

STRING, POSE, SET_BOOL = "std_msgs/String", "geometry_msgs/Pose2D", "std_srvs/SetBool"


class Platform(ABC):
    """A running platform with the user `testUser`."""

    @abstractmethod
    def robot(self, name: str) -> Robot:
        """A robot of that user that is not connected yet; its commands time out after 10 s."""

    @abstractmethod
    def break_socket(self, robot: str) -> None:
        """Break the robot's socket without a closing handshake; its session is kept for it."""

    @abstractmethod
    async def forget(self, robot: str) -> None:
        """Break the robot's socket and end its session at once."""


async def until(condition: Callable[[], bool]) -> None:
    """Let the loop run until the condition holds."""
    async with asyncio.timeout(10):
        while not condition():  # noqa: ASYNC110  # what it reads has no event
            await asyncio.sleep(0)


class ClientContract:
    async def test_a_message_goes_from_robot_to_robot(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            heard = await b.subscriber("heard", POSE)
            said = await a.publisher("said", POSE, to="b/heard")
            await said.publish({"x": 1.5, "y": -2.0, "theta": 0.5})
            assert await heard.get(10) == {"x": 1.5, "y": -2.0, "theta": 0.5}
            assert heard.connected

    async def test_order_is_kept_and_a_callback_gets_each_message_once(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            got: list[str] = []
            done = asyncio.Event()

            async def hear(message: dict[str, str]) -> None:
                got.append(message["data"])
                if message["data"] == "99":
                    done.set()
                if message["data"] == "50":
                    raise ValueError("a callback that fails is called again with the next message")

            await b.subscriber("heard", STRING, callback=hear, depth=100)
            said = await a.publisher("said", STRING, to="b/heard")
            for number in range(100):
                await said.publish({"data": str(number)})
            await asyncio.wait_for(done.wait(), 10)
            assert got == [str(number) for number in range(100)]

    async def test_raw_bytes_pass_untouched_whatever_their_size(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            heard = await b.subscriber("heard", STRING, raw=True)
            said = await a.publisher("said", STRING, to="b/heard", raw=True)
            for size in (1, 1000, PART, 3 * PART + 1):
                payload = random.randbytes(size)
                await said.publish(payload)
                assert await heard.get(10) == payload

    async def test_a_small_message_overtakes_a_large_one(self, platform: Platform) -> None:
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
            await asyncio.wait_for(done.wait(), 20)
            assert order == ["small", "large"]

    async def test_a_service_answers_and_fails(self, platform: Platform) -> None:
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

    async def test_a_plain_handler_may_provide_a_service_and_a_slow_one_times_out(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            never = asyncio.Event()
            await b.service_provider("quick", SET_BOOL, lambda request: {"success": request["data"], "message": ""})
            await b.service_provider("slow", SET_BOOL, lambda request: never.wait())
            quick = await a.service_client("quick", SET_BOOL, to="b/quick")
            assert await quick.call({"data": True}) == {"success": True, "message": ""}
            slow = await a.service_client("slow", SET_BOOL, to="b/slow")
            with pytest.raises(TimedOut, match="slow"):
                await slow.call({"data": True}, timeout=0.05)

    async def test_commands_raise_their_errors(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            await a.publisher("said", STRING)
            await b.subscriber("heard", POSE)
            with pytest.raises(NotFound):
                await a.connect("a/said", "b/nothing")
            with pytest.raises(NotConnectable):
                await a.connect("a/said", "b/heard")
            with pytest.raises(AlreadyExists) as caught:
                await a.configure(
                    AddInterface("a", "other", "SubscriberConverter", STRING),
                    AddInterface("a", "said", "SubscriberConverter", STRING),
                )
            assert caught.value.item == "commands[1]"
            await a.remove_interface("a", "other")
            with pytest.raises(NotFound):
                await a.remove_interface("a", "other")

    async def test_what_could_not_be_connected_leaves_no_trace(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            with pytest.raises(NotFound):
                await a.publisher("said", STRING, to="b/heard")
            heard = await b.subscriber("heard", STRING)
            said = await a.publisher("said", STRING, to="b/heard")
            await said.publish({"data": "x"})
            assert await heard.get(10) == {"data": "x"}

    async def test_publishing_without_a_peer_raises_and_offering_drops(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            said = await a.publisher("said", STRING)
            with pytest.raises(NotConnected, match="a/said"):
                await said.publish({"data": "x"}, timeout=0.01)
            assert not said.offer({"data": "x"})
            assert said.dropped == 1
            heard = await b.subscriber("heard", STRING, to="a/said")
            await said.wait_connected(10)
            assert said.offer({"data": "y"})
            assert await heard.get(10) == {"data": "y"}
            await heard.close()
            await until(lambda: not said.connected)

    async def test_a_resumed_robot_goes_on_as_it_was(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            heard = await b.subscriber("heard", STRING)
            said = await a.publisher("said", STRING, to="b/heard")
            back = await b.subscriber("back", STRING)
            answer = await a.publisher("answer", STRING, to="b/back")
            for robot, name in ((a, "a"), (b, "b")):
                events = robot.events()
                platform.break_socket(name)
                assert isinstance(await events.get(10), Disconnected)
                assert await events.get(10) == Reconnected(resumed=True)
                await said.publish({"data": name})
                await answer.publish({"data": name})
                assert await heard.get(10) == {"data": name}
                assert await back.get(10) == {"data": name}

    async def test_a_robot_that_could_not_resume_declares_everything_again(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            heard = await b.subscriber("heard", STRING)
            await b.service_provider("serve", SET_BOOL, lambda request: {"success": True, "message": ""})
            said = await a.publisher("said", STRING, to="b/heard")
            call = await a.service_client("call", SET_BOOL, to="b/serve")
            gone = await a.publisher("gone", STRING, to="b/heard")
            await gone.close()
            events = a.events()
            await platform.forget("a")
            assert isinstance(await events.get(10), Disconnected)
            assert await events.get(10) == Reconnected(resumed=False)
            await said.publish({"data": "again"})
            assert await heard.get(10) == {"data": "again"}
            assert (await call.call({"data": True}))["success"]
            with pytest.raises(NotFound):
                await a.remove_interface("a", "gone")

    async def test_commands_issued_while_away_are_carried_out(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            heard = await b.subscriber("heard", STRING)
            platform.break_socket("a")
            said = await a.publisher("said", STRING, to="b/heard")
            await said.publish({"data": "x"})
            assert await heard.get(10) == {"data": "x"}

    async def test_a_call_whose_socket_breaks_is_unavailable(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            called, never = asyncio.Event(), asyncio.Event()

            async def hang(request: dict[str, bool]) -> None:
                called.set()
                await never.wait()

            await b.service_provider("serve", SET_BOOL, hang)
            client = await a.service_client("call", SET_BOOL, to="b/serve")
            call = asyncio.create_task(client.call({"data": True}))
            await asyncio.wait_for(called.wait(), 10)
            events = a.events()
            platform.break_socket("a")
            with pytest.raises(Unavailable, match="not known"):
                await call
            assert isinstance(await events.get(10), Disconnected)
            assert await events.get(10) == Reconnected(resumed=True)

    async def test_nothing_is_delivered_twice_across_breaks(self, platform: Platform) -> None:
        async with platform.robot("a") as a, platform.robot("b") as b:
            heard = await b.subscriber("heard", STRING, depth=10_000)
            said = await a.publisher("said", STRING, to="b/heard")
            numbers, got = itertools.count(), []

            for _ in range(3):
                events = a.events()
                platform.break_socket("a")
                back = asyncio.create_task(anext(event async for event in events if isinstance(event, Reconnected)))
                while not back.done():
                    await said.publish({"data": str(next(numbers))})
                    await asyncio.sleep(0)
            last = next(numbers)
            await said.publish({"data": str(last)})
            async for message in heard:
                got.append(int(message["data"]))
                if got[-1] == last:
                    break
            assert got == sorted(set(got))

    async def test_closing_sends_what_is_queued_and_ends_the_readers(self, platform: Platform) -> None:
        async with platform.robot("b") as b:
            heard = await b.subscriber("heard", STRING, depth=100)
            async with platform.robot("a") as a:
                own = await a.subscriber("own", STRING)
                said = await a.publisher("said", STRING, to="b/heard")
                for _ in range(20):
                    await said.publish({"data": "x" * 100_000})
            assert [message async for message in own] == []
            for _ in range(20):
                await heard.get(10)
            with pytest.raises(Unavailable):
                await a.connect("a/said", "b/heard")

    async def test_a_robot_that_left_may_come_back_at_once(self, platform: Platform) -> None:
        for _ in range(3):
            async with platform.robot("a") as a:
                await a.publisher("said", STRING)

    async def test_a_name_in_use_is_refused(self, platform: Platform) -> None:
        async with platform.robot("a"):
            with pytest.raises(AlreadyExists):
                await platform.robot("a").open()

    async def test_many_commands_are_carried_out_in_their_order(self, platform: Platform) -> None:
        async with platform.robot("a") as a:
            await a.configure(
                AddInterface("a", "out", "SubscriberConverter", STRING),
                AddInterface("a", "in", "PublisherConverter", STRING),
                Connect("a/out", "a/in"),
            )
            with pytest.raises(AlreadyExists):
                await a.connect("a/in", "a/out")
