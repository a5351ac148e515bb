"""For whom a request acts, and pages of what they may see."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from typing import TypeVar

from master import rights
from master.api.calls import Answer, Call, Paging
from master.records import Record, user_of
from master.rights import EVERYBODY, Principal
from rce.errors import Unauthorized
from rce.views import Page

R = TypeVar("R", bound=Record)
V = TypeVar("V")


def principal(call: Call) -> Principal:
    """Who asks."""
    if call.principal is None:  # a route for all
        raise Unauthorized("say who you are")
    return call.principal


def acting(call: Call, operation: str, user: str, *, robot: str = "", environment: str = "") -> str:
    """The user whose things this is about: `user` if it is given. Forbidden, NotFound."""
    owner = user or call.user
    _check(call, operation, owner, robot, environment)
    return owner


def platform(call: Call, operation: str) -> None:
    """As `acting`, on what is the platform's own."""
    _check(call, operation, rights.NOBODY)


def _check(call: Call, operation: str, owner: str, robot: str = "", environment: str = "") -> None:
    call.trail.operation, call.trail.owner = operation, owner
    rights.check(principal(call), operation, owner, robot=robot, environment=environment)


def listing(call: Call, operation: str, user: str) -> str:
    """As `acting`, for a list: EVERYBODY are all whom the asker may see."""
    if user == EVERYBODY and rights.reach(principal(call), operation) == "own":
        return call.user
    return acting(call, operation, user)


def page(
    records: Iterable[R], user: str, paging: Paging, show: Callable[[R], V], keep: Callable[[V], bool] = lambda _: True
) -> Answer:
    """The part of a list that `paging` asks for, in the order of the keys."""
    wanted = (each for each in records if each.key > paging.after and user in (EVERYBODY, user_of(each.key)))
    return cut(((each.key, show(each)) for each in wanted), paging, keep)


def cut(named: Iterable[tuple[str, V]], paging: Paging, keep: Callable[[V], bool] = lambda _: True) -> Answer:
    """As `page`, of views with their keys."""
    kept = ((key, view) for key, view in named if key > paging.after and keep(view))
    found = heapq.nsmallest(paging.limit + 1, kept, key=lambda pair: pair[0])
    more = len(found) > paging.limit
    found = found[: paging.limit]
    return Answer(Page([view for _, view in found], found[-1][0] if more else ""))
