"""What a control call is: a question from one process to another, with its arguments and the type of its answer."""

from __future__ import annotations

from typing import Generic, TypeVar, get_args

from msgspec import Struct

from rce.errors import ErrorInfo

R = TypeVar("R")


class Call(Struct, Generic[R], frozen=True):
    """A question from one process to another; `R` is the type of the answer."""


def result_type(call: type[Call[R]]) -> type[R]:
    """The type that the answer to `call` has."""
    kind: type[R] = get_args(call.__orig_bases__[0])[0]  # type: ignore[attr-defined]  # every generic subclass has it
    return kind


class Nothing(Struct, frozen=True):
    """The answer of calls that only do something."""


class Settled(Struct, frozen=True):
    """The answer of calls about several things by name: what went wrong, nothing said of what is well."""

    failed: dict[str, ErrorInfo] = {}


class Ping(Call[Nothing], frozen=True):
    """Are you there?"""
