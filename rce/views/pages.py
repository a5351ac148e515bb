"""Lists come in pages."""

from __future__ import annotations

from typing import Generic, TypeVar

from msgspec import Struct

T = TypeVar("T")


class Page(Struct, Generic[T], frozen=True):
    """Part of a list, in the order of the names. `next` goes into `?after=` for what follows; empty: that is all.

    What is there all the while is seen once, also when other things come and go between two pages.
    """

    items: list[T]
    next: str = ""
