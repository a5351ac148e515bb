"""Mirror of a collection of objects, which is listed once and then watched."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from twisted.logger import Logger

from containers.kubernetes.api import GONE, Api, Refused
from containers.kubernetes.objects import Object
from rce.errors import RceError

log = Logger()
RETRY_DELAY = 1.0  # seconds until the next try after Kubernetes did not answer


class Mirror:
    """The objects at `path` that match a label selector, by uid.

    `changed` is called with each object that is new or other than before, and `gone` with the last state of each that
    was removed. After an interruption of the watch all differences are found, so nothing is missed but what has come
    and gone meanwhile.
    """

    def __init__(
        self, api: Api, path: str, selector: str, changed: Callable[[Object], None], gone: Callable[[Object], None]
    ) -> None:
        self.objects: dict[str, Object] = {}
        self._api = api
        self._path = path
        self._query = {"labelSelector": selector} if selector else {}
        self._changed = changed
        self._gone = gone
        self._version = ""
        self._waiting: set[asyncio.Event] = set()
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """List the objects, calling `changed` with each, and watch them from then on.

        Raises:
            Unavailable: Kubernetes does not answer, or refuses.
        """
        await self._list()
        self._task = asyncio.create_task(self._follow())

    async def close(self) -> None:
        """Stop watching; no callback is called later."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})
            self._task = None

    @contextmanager
    def changes(self) -> Iterator[asyncio.Event]:
        """Yield an event that each change sets; clear it before looking, and wait for it after."""
        event = asyncio.Event()
        self._waiting.add(event)
        try:
            yield event
        finally:
            self._waiting.discard(event)

    async def _list(self) -> None:
        found = await self._api.get(self._path, **self._query)
        present = {each["metadata"]["uid"]: each for each in found.get("items") or []}
        self._version = found["metadata"]["resourceVersion"]
        for uid in self.objects.keys() - present.keys():
            self._remove(uid)
        for object in present.values():
            self._set(object)

    async def _follow(self) -> None:
        listed = True
        while True:
            try:
                if not listed:
                    await self._list()
                    listed = True
                await self._watch()
            except RceError as error:
                listed = not (isinstance(error, Refused) and error.status == GONE)
                if listed:
                    log.warn("{path} is not watched: {error}", path=self._path, error=str(error))
                    await asyncio.sleep(RETRY_DELAY)

    async def _watch(self) -> None:
        async for event in self._api.watch(self._path, self._version, **self._query):
            metadata = event.object["metadata"]
            self._version = metadata["resourceVersion"]
            if event.type == "DELETED":
                self.objects[metadata["uid"]] = event.object
                self._remove(metadata["uid"])
            elif event.type in ("ADDED", "MODIFIED"):
                self._set(event.object)

    def _set(self, object: Object) -> None:
        before = self.objects.get(object["metadata"]["uid"])
        self.objects[object["metadata"]["uid"]] = object
        if before != object:
            self._changed(object)
            self._wake()

    def _remove(self, uid: str) -> None:
        self._gone(self.objects.pop(uid))
        self._wake()

    def _wake(self) -> None:
        for event in self._waiting:
            event.set()
