"""Docker's event stream, followed in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, TypedDict

import docker
import requests
import urllib3
from docker.errors import DockerException
from twisted.logger import Logger

log = Logger()
PAUSE = 1.0  # seconds until the stream is taken up again after it broke
ENDS: Mapping[str, Any] = {"type": "container", "event": "die"}


class Actor(TypedDict):
    Attributes: dict[str, str]


class Event(TypedDict):
    """Of Docker's fields that which matters: whose container it is, by its labels."""

    Action: str
    Actor: Actor


class Events:
    """Calls `happened` for each event that passes Docker's `filters`, in the loop that has made this object.

    `taken_up` is called whenever the stream begins: what a daemon that was restarted has seen before is not told.
    """

    def __init__(
        self,
        api: docker.APIClient,
        filters: Mapping[str, Any],
        happened: Callable[[Event], None],
        taken_up: Callable[[], None],
    ) -> None:
        self._api = api
        self._filters = dict(filters)
        self._happened = happened
        self._taken_up = taken_up
        self._loop = asyncio.get_running_loop()
        self._closed = threading.Event()
        self._stream: docker.types.CancellableStream | None = None
        self._thread = threading.Thread(target=self._follow, name="docker events", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Nothing is told after this."""
        self._closed.set()
        if self._stream is not None:
            self._stream.close()

    def _follow(self) -> None:
        since = time.time()
        while not self._closed.is_set():
            try:
                self._stream = self._api.events(since=int(since), filters=self._filters, decode=True)
                self._tell(self._taken_up)
                for event in self._stream:
                    since = time.time()
                    self._tell(self._happened, event)
            except (DockerException, requests.RequestException, urllib3.exceptions.HTTPError, OSError) as error:
                if not self._closed.is_set():
                    log.warn("Docker's event stream broke: {error}", error=str(error))
            self._closed.wait(PAUSE)

    def _tell(self, what: Callable[..., None], *arguments: Event) -> None:
        if not self._closed.is_set():
            self._loop.call_soon_threadsafe(self._say, what, arguments)

    def _say(self, what: Callable[..., None], arguments: tuple[Event, ...]) -> None:
        if not self._closed.is_set():
            what(*arguments)
