"""Access to a Docker daemon off the event loop."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import docker
import requests
from docker.errors import DockerException
from twisted.logger import Logger

from rce.errors import Unavailable

log = Logger()
DOCKER_SOCKET = "/var/run/docker.sock"
ANSWER_TIMEOUT = 60  # seconds for one answer of the daemon
THREADS = 8
R = TypeVar("R")


class AsyncDocker:
    """The daemon of DOCKER_HOST, by default this machine's, called in threads. Subclasses add the calls they need.

    A cancelled call is still carried out; the cancellation is raised when it is done. All calls raise Unavailable if
    the daemon does not answer.
    """

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(THREADS, "docker")
        self._api: docker.APIClient

    async def connect_api(self) -> None:
        """Connect to the daemon; must come before all other calls."""
        self._api = await self._call(_connect)

    async def call(self, work: Callable[[docker.APIClient], R]) -> R:
        """Run `work` with Docker's API in a thread; return its result."""
        return await self._call(lambda: work(self._api))

    async def _call(self, work: Callable[[], R]) -> R:
        future = asyncio.get_running_loop().run_in_executor(self._threads, work)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            await asyncio.wait([future])
            if not future.cancelled() and (error := future.exception()):
                log.info("a cancelled call to Docker failed: {error}", error=str(error))
            raise
        except requests.RequestException as error:
            raise Unavailable(f"Docker does not answer: {error}") from None
        except DockerException as error:
            raise Unavailable(f"Docker: {explanation(error)}") from None


def docker_host() -> str:
    """Return the address of the daemon."""
    return os.environ.get("DOCKER_HOST") or f"unix://{DOCKER_SOCKET}"


def _connect() -> docker.APIClient:
    try:
        return docker.APIClient(**docker.utils.kwargs_from_env(), version="auto", timeout=ANSWER_TIMEOUT)
    except DockerException as error:
        raise Unavailable(
            f"no Docker answers at {docker_host()}: start it, set DOCKER_HOST to another one, or add this user to the "
            f"group docker; {explanation(error)}"
        ) from None


def explanation(error: Exception) -> str:
    """Return Docker's own explanation of an error."""
    return str(getattr(error, "explanation", None) or error)
