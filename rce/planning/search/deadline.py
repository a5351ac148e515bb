"""Clock that stops compiled searches."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Self

import numpy as np

from rce.planning.failures import NoPath, timed_out


class Deadline:
    """Time limit of a search. Use it as a context manager.

    A kernel cannot read the clock. It reads the flag, which a timer sets in a thread of its own, as `stop` does.

    Attributes:
        flag: (1,) uint8, 1 once the search is to end.
    """

    def __init__(self, seconds: float) -> None:
        """Make a limit of this many seconds, which begin with `with`."""
        self._seconds = seconds
        self.flag = np.zeros(1, np.uint8)
        self._timer = threading.Timer(seconds, self.stop)
        self._timer.daemon = True
        self._began = 0.0

    def __enter__(self) -> Self:
        """Start the clock."""
        self._began = time.monotonic()
        self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Stop the clock."""
        self._timer.cancel()

    def stop(self) -> None:
        """End the search now, from whatever thread."""
        self.flag[0] = 1

    def check(self) -> None:
        """Raise NoPath if the search is to end."""
        if self.flag[0]:
            raise self.error()

    def error(self) -> NoPath:
        """Return the error of a search that was ended."""
        return timed_out(self._seconds)

    @property
    def elapsed(self) -> float:
        """Seconds since the clock was started."""
        return time.monotonic() - self._began
