"""The blocking face, used as scripts do: plain threads, no event loop of their own."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import pytest
from client_contract import SET_BOOL, STRING
from fake_platform import FakePlatform

from rce.client import BlockingRobot, Reconnected, Robot
from rce.errors import NotFound, RceError, TimedOut, Unauthorized, Unavailable

T = TypeVar("T")


async def script(function: Callable[..., T], *arguments: Any) -> T:
    """Run a script in a thread, while the fake platform runs here."""
    return await asyncio.wait_for(asyncio.to_thread(function, *arguments), 20)


def robot(url: str, name: str = "a", password: str = "testUser") -> BlockingRobot:
    return BlockingRobot(url, user="testUser", robot=name, password=password, timeout=10)


def test_it_takes_what_a_robot_takes() -> None:
    assert inspect.signature(BlockingRobot).parameters.keys() == inspect.signature(Robot).parameters.keys()


async def test_a_script_talks_to_itself(fake: FakePlatform) -> None:
    def run() -> list[Any]:
        with robot(fake.url) as a, a.environment("brain") as brain:
            brain.add_node("echo", "Test", "stringEcho.py")
            said = a.publisher("said", STRING)
            heard = a.subscriber("heard", STRING, to="a/said", depth=100)
            for number in range(3):
                said.publish({"data": str(number)})
            said.wait_connected()
            assert said.offer({"data": "last"})
            first = heard.get(10)
            found = [first["data"]]
            for message in heard:
                found.append(message["data"])
                if message["data"] == "last":
                    return found
        raise AssertionError("the subscriber ended")

    assert await script(run) == ["0", "1", "2", "last"]
    assert ("environment", "brain") not in fake.names


async def test_errors_are_raised_where_the_call_was_made(fake: FakePlatform) -> None:
    def run() -> None:
        with pytest.raises(Unauthorized):
            robot(fake.url, password="wrong").open()
        with robot(fake.url) as a:
            with pytest.raises(NotFound):
                a.connect("a/said", "a/heard")
            heard = a.subscriber("heard", STRING)
            with pytest.raises(TimedOut):
                heard.get(0.01)
        with pytest.raises(Unavailable):
            a.create_environment("brain")
        with pytest.raises(Unavailable):
            robot(fake.url).create_environment("brain")

    await script(run)


async def test_handlers_may_use_the_robot_themselves(fake: FakePlatform) -> None:
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
            said = a.publisher("said", STRING)
            b.subscriber("heard", STRING, to="a/said", callback=lambda message: done.set())
            said.publish({"data": "x"})
            assert done.wait(10)
            return client.call({"data": True})

    assert await script(run) == {"success": True, "message": "made"}
    assert ("environment", "made_by_handler") in fake.names


async def test_many_threads_share_a_robot(fake: FakePlatform) -> None:
    def run() -> list[str]:
        with robot(fake.url) as a:
            said = a.publisher("said", STRING)
            heard = a.subscriber("heard", STRING, to="a/said", depth=1000)
            with ThreadPoolExecutor(8) as pool:
                for future in [pool.submit(said.publish, {"data": str(number)}) for number in range(200)]:
                    future.result()
            return [heard.get(10)["data"] for _ in range(200)]

    assert sorted(await script(run), key=int) == [str(number) for number in range(200)]


async def test_closing_ends_the_iterations_of_other_threads(fake: FakePlatform) -> None:
    def run() -> int:
        a = robot(fake.url)
        a.open()
        heard = a.subscriber("heard", STRING)
        waiting = threading.Event()

        def messages() -> Iterator[Any]:
            waiting.set()
            yield from heard

        with ThreadPoolExecutor(1) as pool:
            count = pool.submit(lambda: sum(1 for _ in messages()))
            waiting.wait(10)
            a.close()
            return count.result(10)

    assert await script(run) == 0


async def test_events_and_reconnecting(fake: FakePlatform) -> None:
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

    await script(run)
