"""A Docker daemon that is asked off the event loop."""

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
ANSWER_TIMEOUT = 60  # seconds for one answer of the daemon
THREADS = 8
R = TypeVar("R")


class Asked:
    """The daemon of DOCKER_HOST, by default this machine's; a subclass has the questions.

    A call that is cancelled has been carried out all the same when the cancellation comes through. All calls raise
    Unavailable when the daemon does not answer.
    """

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(THREADS, "docker")
        self._api: docker.APIClient

    async def reach(self) -> None:
        """Find the daemon; before all other calls."""
        self._api = await self._call(_connect)

    async def ask(self, work: Callable[[docker.APIClient], R]) -> R:
        """Have `work` done with Docker's API."""
        return await self._call(lambda: work(self._api))

    async def _call(self, work: Callable[[], R]) -> R:
        future = asyncio.get_running_loop().run_in_executor(self._threads, work)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            await asyncio.wait([future])
            if not future.cancelled() and (error := future.exception()):
                log.info("a call that was cancelled failed: {error}", error=str(error))
            raise
        except requests.RequestException as error:
            raise Unavailable(f"Docker does not answer: {error}") from None
        except DockerException as error:
            raise Unavailable(f"Docker: {said(error)}") from None


def _connect() -> docker.APIClient:
    try:
        return docker.APIClient(**docker.utils.kwargs_from_env(), version="auto", timeout=ANSWER_TIMEOUT)
    except DockerException as error:
        host = os.environ.get("DOCKER_HOST") or "unix:///var/run/docker.sock"
        raise Unavailable(
            f"no Docker answers at {host}: start it, or name another by DOCKER_HOST, or see to the rights of this user "
            f"(group docker); {said(error)}"
        ) from None


def said(error: Exception) -> str:
    """What went wrong in Docker's own words."""
    return str(getattr(error, "explanation", None) or error)
