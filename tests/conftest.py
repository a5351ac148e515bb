"""One event loop for all tests, uvloop with Twisted's reactor on it, as in the server processes.

A test that needs control connections, WebSockets or anything else of Twisted's asks for the fixture `reactor`. It fails
when it leaves a delayed call of the reactor behind or when a failure was logged that it did not take from `failures`.
"""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Iterator
from typing import TYPE_CHECKING, Any

import pytest
import uvloop
from twisted.internet.base import ReactorBase
from twisted.logger import LogEvent, globalLogPublisher

from rce import loop
from rce.errors import Unavailable

if TYPE_CHECKING:
    from island import Island

asyncio.set_event_loop_policy(uvloop.EventLoopPolicy())
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # by a shell, in the background: all that tests start would, too
    signal.signal(signal.SIGINT, signal.default_int_handler)

OF_DOCKER = {"docker_host", "images", "island", "swarm", "one_machine", "stand_in_image"}


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """For runs in several processes (`-n 2 --dist loadgroup`): what needs Docker is one group and comes first, since
    daemons and images are made once in a process; else a file is one.
    """
    items.sort(key=lambda item: not _needs_docker(item))
    for item in items:
        group = "docker" if _needs_docker(item) else item.path.name
        item.add_marker(pytest.mark.xdist_group(group))


def _needs_docker(item: pytest.Item) -> bool:
    fixtures = getattr(item, "fixturenames", ())
    return not OF_DOCKER.isdisjoint(fixtures) or "[docker" in item.name


@pytest.fixture(scope="session", autouse=True)
async def running_reactor() -> AsyncIterator[ReactorBase]:
    """For all tests, so that it is there before anything imports `twisted.internet.reactor` and gets another one."""
    reactor = loop.install(asyncio.get_running_loop())
    reactor.startRunning(installSignalHandlers=False)
    yield reactor
    reactor.getThreadPool().stop()  # a real end of the reactor would stop the loop under pytest-asyncio


@pytest.fixture
def failures() -> Iterator[list[LogEvent]]:
    """The failures that were logged during the test; a test that provokes one asserts on it and clears the list."""
    seen: list[LogEvent] = []

    def observe(event: LogEvent) -> None:
        if "log_failure" in event:
            seen.append(event)

    globalLogPublisher.addObserver(observe)  # type: ignore[arg-type]  # mypy does not know zope's interfaces
    yield seen
    globalLogPublisher.removeObserver(observe)  # type: ignore[arg-type]


@pytest.fixture
def reactor(running_reactor: ReactorBase, failures: list[LogEvent]) -> Iterator[ReactorBase]:
    """Twisted's reactor, running on the loop of the tests."""
    before = set(running_reactor.getDelayedCalls())
    yield running_reactor
    left = set(running_reactor.getDelayedCalls()) - before
    assert not left, f"delayed calls left over: {left}"
    assert not failures, "logged: " + "\n".join(event["log_failure"].getTraceback() for event in failures)


@pytest.fixture(scope="session")
def images(docker_host: str) -> Iterator[Any]:
    """Docker's API, with the images of this checkout, built once: two minutes where there is no registry."""
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
    """The address of a Docker daemon, which DOCKER_HOST names while the tests run."""
    pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")
    from docker_daemon import docker_daemon

    before = os.environ.get("DOCKER_HOST")
    with docker_daemon() as host:
        os.environ["DOCKER_HOST"] = host
        yield host
    if before is None:
        del os.environ["DOCKER_HOST"]


@pytest.fixture(scope="session")
def island(request: pytest.FixtureRequest) -> Iterator[Island]:
    """A machine with a network of its own, and a Docker daemon in it, which has the images."""
    pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")
    from island import island as make

    with make(lambda: request.getfixturevalue("images")) as made:
        yield made
