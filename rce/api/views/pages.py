"""Type of a page of a list."""

from __future__ import annotations

from typing import Generic, TypeVar

from msgspec import Struct

T = TypeVar("T")


class Page(Struct, Generic[T], frozen=True):
    """Page of a list, sorted by name. `next` is the value of `?after=` for the next page; empty on the last page.

    Items that exist during all of the requests are listed exactly once, even if others are added or removed meanwhile.
    """

    items: list[T]
    next: str = ""
