"""Places for requests at the servers of services, shared by all interfaces of an environment.

A ROS 2 server queues 10 requests and loses all beyond. So few of them are on their way to a server at once, however
many robots call it.
"""

from __future__ import annotations

from collections.abc import Callable
from weakref import WeakValueDictionary

MAX_IN_FLIGHT = 8


class Slots:
    """Places for the unanswered requests of one service."""

    def __init__(self) -> None:
        self._free = MAX_IN_FLIGHT
        self._waiting: dict[Callable[[], None], None] = {}  # in the order in which they came

    def take(self, resume: Callable[[], None]) -> bool:
        """Take a place. If there is none, return False, and call `resume` when there is one."""
        if self._free:
            self._free -= 1
            return True
        self._waiting[resume] = None
        return False

    def give_back(self) -> None:
        """Give a place to who waits for one; one after the other, since who is called may want none any more."""
        self._free += 1
        while self._free and self._waiting:
            resume = next(iter(self._waiting))
            del self._waiting[resume]
            resume()

    def leave(self, resume: Callable[[], None]) -> None:
        """Wait no more."""
        self._waiting.pop(resume, None)


class ServiceSlots:
    """Slots by the names of services, as long as somebody calls them."""

    def __init__(self) -> None:
        self._slots: WeakValueDictionary[str, Slots] = WeakValueDictionary()

    def of(self, service: str) -> Slots:
        """Return the slots of a service."""
        return self._slots.setdefault(f"/{service.lstrip('/')}", Slots())
