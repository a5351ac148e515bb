"""Docker's event stream, followed in a thread."""

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
RECONNECT_DELAY = 1.0  # seconds until the stream is opened again after it broke
ENDS: Mapping[str, Any] = {"type": "container", "event": "die"}


class Actor(TypedDict):
    """Object that an event is about."""

    Attributes: dict[str, str]


class Event(TypedDict):
    """Event of Docker, with the fields used here; the attributes of its actor include the container's labels."""

    Action: str
    Actor: Actor


class Events:
    """Calls `on_event` for each event that passes Docker's `filters`, in the event loop that created this object.

    `on_resumed` is called whenever the stream begins: events before that may have been lost if the daemon restarted, so
    the caller must query the current state.
    """

    def __init__(
        self,
        api: docker.APIClient,
        filters: Mapping[str, Any],
        on_event: Callable[[Event], None],
        on_resumed: Callable[[], None],
    ) -> None:
        self._api = api
        self._filters = dict(filters)
        self._on_event = on_event
        self._on_resumed = on_resumed
        self._loop = asyncio.get_running_loop()
        self._closed = threading.Event()
        self._stream: docker.types.CancellableStream | None = None
        self._thread = threading.Thread(target=self._follow, name="docker events", daemon=True)

    def start(self) -> None:
        """Start following events."""
        self._thread.start()

    def close(self) -> None:
        """Stop following events; no callback is called later."""
        self._closed.set()
        if self._stream is not None:
            self._stream.close()

    def _follow(self) -> None:
        since = time.time()
        while not self._closed.is_set():
            try:
                stream = self._stream = self._api.events(since=int(since), filters=self._filters, decode=True)
                if self._closed.is_set():  # by a thread that did not see the stream yet
                    stream.close()
                self._post(self._on_resumed)
                for event in stream:
                    since = time.time()
                    self._post(self._on_event, event)
            except (DockerException, requests.RequestException, urllib3.exceptions.HTTPError, OSError) as error:
                if not self._closed.is_set():
                    log.warn("Docker's event stream broke: {error}", error=str(error))
            self._closed.wait(RECONNECT_DELAY)

    def _post(self, callback: Callable[..., None], *arguments: Event) -> None:
        """Schedule a callback in the event loop, from the thread."""
        if not self._closed.is_set():
            self._loop.call_soon_threadsafe(self._deliver, callback, arguments)

    def _deliver(self, callback: Callable[..., None], arguments: tuple[Event, ...]) -> None:
        if not self._closed.is_set():
            callback(*arguments)
