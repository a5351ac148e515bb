"""The blocking client in plain threads, as scripts use it."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import pytest

from rce.client import BlockingRobot, Reconnected, Robot
from rce.client.actions import ActionClient, ActionServer, Goal
from rce.client.blocking import BlockingEnvironment
from rce.client.blocking_interfaces import (
    BlockingActionClient,
    BlockingActionServer,
    BlockingGoal,
    BlockingPublisher,
    BlockingServiceClient,
    BlockingServiceProvider,
    BlockingSubscriber,
)
from rce.client.environment import Environment
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.topics import Publisher, Subscriber
from rce.errors import NotFound, RceError, TimedOut, Unauthorized, Unavailable
from rce.protocol.messages import Qos
from tests.support.client_contract import SET_BOOL, STRING
from tests.support.fake_platform import FakePlatform

T = TypeVar("T")


async def run_script(function: Callable[..., T], *arguments: Any) -> T:
    """Run a script in a thread while the fake platform runs on this loop."""
    return await asyncio.wait_for(asyncio.to_thread(function, *arguments), 60)


def robot(url: str, name: str = "a", password: str = "testUser") -> BlockingRobot:
    return BlockingRobot(url, user="testUser", robot=name, password=password, timeout=60)


def test_constructor_has_the_arguments_of_robot() -> None:
    assert inspect.signature(BlockingRobot).parameters.keys() == inspect.signature(Robot).parameters.keys()


@pytest.mark.parametrize(
    ("blocking", "asynchronous"),
    [
        (BlockingRobot, Robot),
        (BlockingEnvironment, Environment),
        (BlockingPublisher, Publisher),
        (BlockingSubscriber, Subscriber),
        (BlockingServiceClient, ServiceClient),
        (BlockingServiceProvider, ServiceProvider),
        (BlockingActionClient, ActionClient),
        (BlockingActionServer, ActionServer),
        (BlockingGoal, Goal),
    ],
    ids=lambda kind: kind.__name__,
)
def test_methods_have_the_arguments_of_the_asyncio_client(blocking: type[Any], asynchronous: type[Any]) -> None:
    for name, method in inspect.getmembers(asynchronous, inspect.isfunction):
        if name.startswith("_") or (asynchronous is Subscriber and name == "call"):  # a callback, given to `subscriber`
            continue
        found = inspect.signature(getattr(blocking, name)).parameters
        wanted = inspect.signature(method).parameters
        assert [(each.name, each.kind, each.default) for each in found.values()] == [
            (each.name, each.kind, each.default) for each in wanted.values()
        ], name


def test_signature_has_the_blocking_result() -> None:
    assert inspect.signature(BlockingRobot.publisher).return_annotation is BlockingPublisher
    assert inspect.signature(BlockingEnvironment.service_client).return_annotation is BlockingServiceClient


async def test_settings_of_interfaces_reach_the_platform(fake: FakePlatform) -> None:
    def run() -> None:
        with robot(fake.url) as a:
            brain = a.environment("brain")
            a.publisher("out", STRING, qos=Qos(depth=3))
            a.subscriber("in", STRING, qos=Qos(depth=4), format="jpeg")
            brain.publisher("/images", STRING, format="jpeg")
            brain.subscriber("/images", STRING, format="json", qos=Qos(depth=5))
            made = {name: (each.get("qos"), each.get("format")) for name, each in fake.interfaces.items()}
            assert made["a/out"] == ({"depth": 3}, None)
            assert made["a/in"] == ({"depth": 4}, "jpeg")
            assert made["a/brain_pub_images"] == (None, "jpeg")
            assert made["a/brain_sub_images"] == ({"depth": 5}, "json")

    await run_script(run)


async def test_script_publishes_and_subscribes(fake: FakePlatform) -> None:
    def run() -> list[Any]:
        with robot(fake.url) as a, a.environment("brain") as brain:
            brain.add_node("echo", "Test", "stringEcho.py")
            publisher = a.publisher("out", STRING)
            subscriber = a.subscriber("in", STRING, to="a/out", depth=100)
            for number in range(3):
                publisher.publish({"data": str(number)})
            publisher.wait_connected()
            assert publisher.offer({"data": "last"})
            first = subscriber.get(10)
            received = [first["data"]]
            for message in subscriber:
                received.append(message["data"])
                if message["data"] == "last":
                    return received
        raise AssertionError("the subscriber ended")

    assert await run_script(run) == ["0", "1", "2", "last"]
    assert ("environment", "brain") not in fake.resources


async def test_errors_are_raised_in_the_calling_thread(fake: FakePlatform) -> None:
    def run() -> None:
        with pytest.raises(Unauthorized):
            robot(fake.url, password="wrong").open()
        with robot(fake.url) as a:
            with pytest.raises(NotFound):
                a.connect("a/out", "a/in")
            subscriber = a.subscriber("in", STRING)
            with pytest.raises(TimedOut):
                subscriber.get(0.01)
        with pytest.raises(Unavailable):
            a.create_environment("brain")
        with pytest.raises(Unavailable):
            robot(fake.url).create_environment("brain")

    await run_script(run)


async def test_handlers_may_use_the_robot(fake: FakePlatform) -> None:
    def run() -> Any:
        with robot(fake.url, "a") as a, robot(fake.url, "b") as b:

            def handler(request: dict[str, bool]) -> dict[str, Any]:
                if not request["data"]:
                    raise ValueError("stuck")
                b.create_environment("made_by_handler")
                return {"success": True, "message": "made"}

            b.service_provider("serve", SET_BOOL, handler)
            client = a.service_client("call", SET_BOOL, to="b/serve")
            with pytest.raises(RceError, match="stuck"):
                client.call({"data": False})
            done = threading.Event()
            publisher = a.publisher("out", STRING)
            b.subscriber("in", STRING, to="a/out", callback=lambda message: done.set())
            publisher.publish({"data": "x"})
            assert done.wait(10)
            return client.call({"data": True})

    assert await run_script(run) == {"success": True, "message": "made"}
    assert ("environment", "made_by_handler") in fake.resources


async def test_many_threads_may_share_a_robot(fake: FakePlatform) -> None:
    def run() -> list[str]:
        with robot(fake.url) as a:
            publisher = a.publisher("out", STRING)
            subscriber = a.subscriber("in", STRING, to="a/out", depth=1000)
            with ThreadPoolExecutor(8) as pool:
                for future in [pool.submit(publisher.publish, {"data": str(number)}) for number in range(200)]:
                    future.result()
            return [subscriber.get(10)["data"] for _ in range(200)]

    assert sorted(await run_script(run), key=int) == [str(number) for number in range(200)]


async def test_close_ends_iterations_in_other_threads(fake: FakePlatform) -> None:
    def run() -> int:
        a = robot(fake.url)
        a.open()
        subscriber = a.subscriber("in", STRING)
        waiting = threading.Event()

        def messages() -> Iterator[Any]:
            waiting.set()
            yield from subscriber

        with ThreadPoolExecutor(1) as pool:
            count = pool.submit(lambda: sum(1 for _ in messages()))
            waiting.wait(10)
            a.close()
            return count.result(10)

    assert await run_script(run) == 0


async def test_events_and_reconnection(fake: FakePlatform) -> None:
    loop = asyncio.get_running_loop()

    def run() -> None:
        with robot(fake.url) as a:
            events = a.events()
            loop.call_soon_threadsafe(fake.break_socket, "a")
            assert any(event == Reconnected(resumed=True) for event in events)
            a.create_environment("brain")
            assert a.connected
            assert "ack" in a.features
            assert a.name == "a"

    await run_script(run)
