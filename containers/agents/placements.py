"""Placement of a run of an environment on a node, which settles when its agent serves it."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from rce.errors import RceError


def _new_future() -> asyncio.Future[None]:
    return asyncio.get_running_loop().create_future()


@dataclass
class Placement:
    """A run of an environment; `settled` is done when its agent serves it, or when it cannot start."""

    run: str
    settled: asyncio.Future[None] = field(default_factory=_new_future, kw_only=True)

    def settle(self, error: RceError | None = None) -> bool:
        """Settle the placement, with an error if it failed; return False if it was settled before."""
        if self.settled.done():
            return False
        if error is None:
            self.settled.set_result(None)
        else:
            self.settled.set_exception(error)
            self.settled.exception()  # nobody may wait for it any more
        return True
