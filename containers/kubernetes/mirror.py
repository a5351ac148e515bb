"""Mirror of a collection of objects, which is listed once and then watched."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

from twisted.logger import Logger

from containers.kubernetes.api import GONE, Api, Refused
from containers.kubernetes.objects import Object
from rce.errors import RceError

log = Logger()
RETRY_DELAY = 1.0  # seconds until the next try after Kubernetes did not answer
T = TypeVar("T")


class Mirror(Generic[T]):
    """The objects at `path` that match a label selector, by uid, as `read` reads them.

    An object that `read` fails for is left out: anybody who may write to the cluster may have made it. `changed` is
    called with each object that is new or other than before, and `gone` with the last state of each that was removed.
    After an interruption of the watch all differences are found, so nothing is missed but what has come and gone
    meanwhile.
    """

    def __init__(
        self,
        api: Api,
        path: str,
        selector: str,
        read: Callable[[Object], T],
        changed: Callable[[T], None],
        gone: Callable[[T], None],
    ) -> None:
        self.objects: dict[str, T] = {}
        self._api = api
        self._read = read
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
        for uid, object in present.items():
            self._set(uid, object)

    async def _follow(self) -> None:
        listed = True
        while True:
            try:
                if not listed:
                    await self._list()
                    listed = True
                await self._watch()
            except RceError as error:
                if isinstance(error, Refused) and error.status == GONE:
                    listed = False
                    continue
                log.warn("{path} is not watched: {error}", path=self._path, error=str(error))
                await asyncio.sleep(RETRY_DELAY)
            except Exception:  # noqa: BLE001  # a defect must not end the watch, on which all environments depend
                log.failure("{path} is listed anew", path=self._path)
                listed = False
                await asyncio.sleep(RETRY_DELAY)

    async def _watch(self) -> None:
        async for event in self._api.watch(self._path, self._version, **self._query):
            metadata = event.object["metadata"]
            self._version = metadata["resourceVersion"]
            if event.type == "DELETED":
                if (last := self._try_to_read(event.object)) is not None:
                    self.objects[metadata["uid"]] = last
                self._remove(metadata["uid"])
            elif event.type in ("ADDED", "MODIFIED"):
                self._set(metadata["uid"], event.object)

    def _set(self, uid: str, object: Object) -> None:
        found, before = self._try_to_read(object), self.objects.get(uid)
        if found is not None and found != before:
            self.objects[uid] = found
            self._tell(self._changed, found)

    def _try_to_read(self, object: Object) -> T | None:
        try:
            return self._read(object)
        except Exception as error:  # noqa: BLE001  # whatever a malformed object leads to
            name = object["metadata"].get("name")
            log.warn("{path}: {name} is malformed: {error!r}", path=self._path, name=name, error=error)
            return None

    def _remove(self, uid: str) -> None:
        if (last := self.objects.pop(uid, None)) is not None:
            self._tell(self._gone, last)

    def _tell(self, report: Callable[[T], None], found: T) -> None:
        try:
            report(found)
        except Exception:  # noqa: BLE001  # a defect must not keep others from being told
            log.failure("defect while a change at {path} was handled", path=self._path)
        for event in self._waiting:
            event.set()
