"""Kubernetes' API in memory: objects by path, and watches that a test feeds."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from containers.kubernetes.api import Api, Event
from containers.kubernetes.objects import Object
from rce.errors import NotFound, RceError


class FakeApi(Api):
    """Takes the place of `Api`; `steps` records what was changed."""

    def __init__(self, lists: dict[str, list[Object]] | None = None) -> None:
        super().__init__()
        self.lists = lists or {}
        self.objects: dict[str, Object] = {}
        self.steps: list[str] = []
        self.events: asyncio.Queue[Event | RceError] = asyncio.Queue()
        self.listed = 0

    async def get(self, path: str, **query: str) -> Object:
        if path in self.objects:
            return self.objects[path]
        if path not in self.lists:
            raise NotFound(f"Kubernetes: {path} not found")
        self.listed += 1
        return {"metadata": {"resourceVersion": str(self.listed)}, "items": list(self.lists[path])}

    async def apply(self, path: str, body: Object) -> Object:
        self.steps.append(f"apply {path}")
        self.objects[path] = body
        return body

    async def text(self, path: str, **query: str) -> str:
        raise NotFound(f"Kubernetes: {path} not found")

    async def delete(self, path: str, grace: int | None = None, uid: str = "") -> bool:
        self.steps.append(f"delete {path}")
        return self.objects.pop(path, None) is not None

    async def watch(self, path: str, version: str, **query: str) -> AsyncIterator[Event]:
        while True:
            event = await self.events.get()
            if isinstance(event, RceError):
                raise event
            yield event


def thing(uid: str, version: int = 1, **fields: Any) -> Object:
    """Return an object with this uid, and name, in this version."""
    return {"metadata": {"uid": uid, "name": uid, "resourceVersion": str(version)}, **fields}
