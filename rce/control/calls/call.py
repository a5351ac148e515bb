"""Base class of control calls, and results that several calls share."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar, Generic, TypeVar, get_args

from msgspec import Struct

from rce.errors import ErrorInfo

R = TypeVar("R")


class Call(Struct, Generic[R], frozen=True):
    """Call from one process to another; the fields are its arguments, `R` is the type of its result.

    Attributes:
        timeout: Seconds within which the answer must come.
    """

    timeout: ClassVar[float] = 60.0


def result_type(call: type[Call[R]]) -> type[R]:
    """Return the type of a call's result."""
    kind: type[R] = _type_argument(call)
    return kind


@cache
def _type_argument(call: type) -> Any:
    return get_args(call.__orig_bases__[0])[0]  # type: ignore[attr-defined]  # every generic subclass has it


class Nothing(Struct, frozen=True):
    """Result of calls that return nothing."""


class BatchResult(Struct, frozen=True):
    """Result of calls about several named objects: the errors of those that failed."""

    failed: dict[str, ErrorInfo] = {}
