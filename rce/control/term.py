"""Terms of Masters: of several Masters one leads at a time, and each leadership has a higher term than all before it.

The term is in the greeting and in each call of a control connection. A Master that was stopped, and does not know yet
that another one leads, is refused by all that know the later term.
"""

from __future__ import annotations

from typing import Protocol

from rce.errors import Unavailable


class Fence(Protocol):
    """Error for a call that a process refuses."""

    @property
    def term(self) -> int:
        """The term that this process sends with its greeting and its calls."""

    def check(self, term: int) -> None:
        """Refuse a greeting or a call that was sent with this term.

        Raises:
            Unavailable: It is of a Master that does not lead any more, or for one.
        """


class Unfenced:
    """Fence of processes without a Master at either end, and of a Master that is alone: it refuses nothing."""

    term = 0

    def check(self, term: int) -> None:
        """Refuse nothing."""


class KnownTerm:
    """Fence of a process that Masters lead: it refuses all terms before the latest that it knows."""

    def __init__(self) -> None:
        self.term = 0

    def check(self, term: int) -> None:
        """Take a term that is not earlier than the latest, as `Fence.check`."""
        if term < self.term:
            raise Unavailable(
                f"this Master has term {term}, and another one led with term {self.term}: it does not lead any more"
            )
        self.term = term
