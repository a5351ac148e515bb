"""One event loop for all tests, uvloop with Twisted's reactor on it, as in the server processes.

A test that needs control connections, WebSockets or anything else of Twisted uses the fixture `reactor`. Such a test
fails if it leaves a delayed call in the reactor, or if a failure was logged that it did not remove from `failures`.
"""

from __future__ import annotations

import asyncio
import functools
import gc
import inspect
import os
import signal
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import uvloop
from hypothesis import HealthCheck, settings
from twisted.internet.base import ReactorBase
from twisted.logger import LogEvent, globalLogPublisher

from provisioning.development import SLOW_FOLDERS
from rce.errors import Unavailable
from rce.process import loop
from tests.support.hand_turned import HandTurnedLoop

if TYPE_CHECKING:
    from tests.support.island import Island

asyncio.set_event_loop_policy(uvloop.EventLoopPolicy())
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # inherited from a background shell, as the children would
    signal.signal(signal.SIGINT, signal.default_int_handler)

os.environ["RCE_ALLOW_ROOT"] = "true"  # CI runs as root, in a container
# A busy machine stands still for a moment now and then; that is no fault of an example.
settings.register_profile("tests", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("tests")

TESTS = Path(__file__).parent
KUBERNETES_FIXTURES = {"cluster", "two_nodes"}
DOCKER_FIXTURES = {"docker_host", "images", "island", "swarm", "one_machine", "stand_in_image"}
ID_LENGTH = 100  # of a parameter; some are messages of megabytes
TIMEOUTS = {"docker": 2400, "kubernetes": 900, "e2e": 600}  # seconds; the first with Docker builds the images


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Assign markers, time limits, and groups for runs in several processes (`-n 2 --dist loadgroup`).

    All tests with Docker are one group, because its daemons and images are made once in each process. They come first,
    because they take longest. Otherwise a file is a group.
    """
    items.sort(key=lambda item: not _needs_docker(item))
    for item in items:
        path = item.path.relative_to(TESTS)
        conditions = {
            "docker": _needs_docker(item),
            "e2e": path.is_relative_to("e2e"),
            "kubernetes": _needs_cluster(item),
            "ros": any(path.is_relative_to(folder) for folder in SLOW_FOLDERS),
        }
        for marker, applies in conditions.items():
            if applies:
                item.add_marker(marker)
        machine = next((each for each in ("docker", "kubernetes") if conditions[each]), "")
        item.add_marker(pytest.mark.xdist_group(machine or path.as_posix()))
        _limit_time(item)


def pytest_make_parametrize_id(val: object) -> str | None:
    """Name long parameters after their beginnings, since pytest-xdist sends the name of a test several times."""
    return f"{val[:ID_LENGTH]!r}..." if isinstance(val, str | bytes) and len(val) > ID_LENGTH else None


def pytest_collection_finish() -> None:
    """Leave all modules and tests out of garbage collection, which would stop the event loop for a second at times."""
    gc.collect()
    gc.freeze()


def _limit_time(item: pytest.Item) -> None:
    """Let coroutines fail by a TimeoutError, before pytest-timeout ends the whole process."""
    limit = next((seconds for marker, seconds in TIMEOUTS.items() if item.get_closest_marker(marker)), None)
    if limit and item.get_closest_marker("timeout") is None:
        item.add_marker(pytest.mark.timeout(limit))
    marker = item.get_closest_marker("timeout")
    seconds = float(marker.args[0] if marker else item.config.getini("timeout"))
    test = getattr(item, "obj", None)
    if inspect.iscoroutinefunction(test) and not hasattr(test, "hypothesis"):

        @functools.wraps(test)
        async def limited(*args: Any, **kwargs: Any) -> None:
            async with asyncio.timeout(0.8 * seconds):
                await test(*args, **kwargs)

        item.obj = limited  # type: ignore[attr-defined]  # it is a function, which has an object


def _needs_docker(item: pytest.Item) -> bool:
    fixtures = getattr(item, "fixturenames", ())
    return not DOCKER_FIXTURES.isdisjoint(fixtures) or "[docker" in item.name


def _needs_cluster(item: pytest.Item) -> bool:
    return not KUBERNETES_FIXTURES.isdisjoint(getattr(item, "fixturenames", ()))


@pytest.fixture
def hand() -> Iterator[HandTurnedLoop]:
    """Event loop whose time is turned by hand; the test fails if an exception was not retrieved."""
    hand = HandTurnedLoop()
    unhandled: list[dict[str, Any]] = []
    hand.set_exception_handler(lambda _, context: unhandled.append(context))
    yield hand
    for task in asyncio.all_tasks(hand):
        task.cancel()
    hand.settle()
    hand.close()
    assert not unhandled


@pytest.fixture(scope="session", autouse=True)
async def running_reactor() -> AsyncIterator[ReactorBase]:
    """Install the reactor for all tests, before anything imports `twisted.internet.reactor` and so installs another."""
    reactor = loop.install(asyncio.get_running_loop())
    reactor.startRunning(installSignalHandlers=False)
    yield reactor
    reactor.getThreadPool().stop()  # stopping the reactor would stop the loop of pytest-asyncio


@pytest.fixture
def failures() -> Iterator[list[LogEvent]]:
    """Failures that were logged during the test. A test that provokes one asserts on it and clears the list."""
    seen: list[LogEvent] = []

    def observe(event: LogEvent) -> None:
        if "log_failure" in event:
            seen.append(event)

    globalLogPublisher.addObserver(observe)  # type: ignore[arg-type]  # mypy does not know zope's interfaces
    yield seen
    globalLogPublisher.removeObserver(observe)  # type: ignore[arg-type]


@pytest.fixture
def reactor(running_reactor: ReactorBase, failures: list[LogEvent]) -> Iterator[ReactorBase]:
    """Twisted's reactor, running on the event loop of the tests."""
    before = set(running_reactor.getDelayedCalls())
    yield running_reactor
    left = set(running_reactor.getDelayedCalls()) - before
    assert not left, f"delayed calls left over: {left}"
    assert not failures, "logged: " + "\n".join(event["log_failure"].getTraceback() for event in failures)


@pytest.fixture(scope="session")
def images(docker_host: str) -> Iterator[Any]:
    """Docker's API, with the images of this checkout, built once. That takes two minutes without a registry."""
    import docker

    from provisioning.image import Builder

    api = docker.APIClient(base_url=docker_host, version="auto", timeout=600)
    try:
        Builder(api).build()
    except Unavailable as error:
        pytest.skip(str(error))
    yield api
    api.close()


@pytest.fixture(scope="session")
def docker_host() -> Iterator[str]:
    """Address of a Docker daemon, also in DOCKER_HOST while the tests run."""
    pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")
    from tests.support.docker_daemon import docker_daemon

    before = os.environ.get("DOCKER_HOST")
    with docker_daemon() as host:
        os.environ["DOCKER_HOST"] = host
        yield host
    if before is None:
        del os.environ["DOCKER_HOST"]


@pytest.fixture(scope="session")
def island(request: pytest.FixtureRequest) -> Iterator[Island]:
    """Network namespace with a Docker daemon in it that has the images."""
    pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")
    from tests.support.island import island as make

    with make(lambda: request.getfixturevalue("images")) as made:
        yield made
