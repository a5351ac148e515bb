"""Readiness of what records name: whether it is there at its process, and who waits for it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from master.graph.records import Ref
from rce.errors import RceError, TimedOut


class Readiness:
    """References that are ready, and those who wait for others. `observers` are called with each that changed."""

    def __init__(self) -> None:
        self.observers: list[Callable[[Ref], None]] = []
        self._ready: set[Ref] = set()
        self._waiting: dict[Ref, set[asyncio.Future[None]]] = {}

    def is_ready(self, ref: Ref) -> bool:
        """Return whether `ref` is ready now."""
        return ref in self._ready

    def waiters(self) -> int:
        """Count the futures that wait."""
        return sum(map(len, self._waiting.values()))

    def mark_ready(self, ref: Ref) -> None:
        """Mark `ref` ready and wake who waits for it."""
        self._change(ref, True)
        for future in self._pending(ref):
            future.set_result(None)

    def fail(self, ref: Ref, error: RceError) -> bool:
        """Mark `ref` not ready and raise `error` in those who wait for it. Return whether there were any."""
        self._change(ref, False)
        pending = self._pending(ref)
        for future in pending:
            future.set_exception(error)
        return bool(pending)

    def release(self, ref: Ref) -> None:
        """Mark `ref` not ready and wake who waits for it without an error: a command removed it on purpose."""
        self._change(ref, False)
        for future in self._pending(ref):
            future.set_result(None)

    def forget(self, ref: Ref) -> None:
        """Mark `ref` not ready; who waits for it goes on waiting."""
        self._change(ref, False)

    def when_ready(self, ref: Ref) -> asyncio.Future[None]:
        """Return a future that resolves when `ref` is ready, or fails with the reason why it never will be."""
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        if ref in self._ready:
            future.set_result(None)
        else:
            self._waiting.setdefault(ref, set()).add(future)
        return future

    async def wait(self, ref: Ref, seconds: float, future: asyncio.Future[None] | None = None) -> None:
        """Wait until `ref` is ready; `future` is an earlier result of `when_ready`.

        Raises:
            TimedOut: It was not ready within `seconds`.
            RceError: The reason why it never will be ready.
        """
        future = future or self.when_ready(ref)
        if future.done():
            return future.result()
        try:
            await asyncio.wait_for(future, seconds)
        except TimeoutError:
            raise TimedOut(f"{ref} did not come up within {seconds:g} s") from None
        finally:
            self._stop_waiting(ref, future)

    def _change(self, ref: Ref, ready: bool) -> None:
        if ready != (ref in self._ready):
            (self._ready.add if ready else self._ready.discard)(ref)
            for observer in self.observers:
                observer(ref)

    def _pending(self, ref: Ref) -> list[asyncio.Future[None]]:
        return [future for future in self._waiting.pop(ref, ()) if not future.done()]

    def _stop_waiting(self, ref: Ref, future: asyncio.Future[None]) -> None:
        waiting = self._waiting.get(ref)
        if waiting is not None:
            waiting.discard(future)
            if not waiting:
                del self._waiting[ref]
