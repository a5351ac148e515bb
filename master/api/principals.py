"""Authorization of API calls, and pages of the resources that a principal may see."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from typing import TypeVar

from master.access import rights
from master.access.rights import EVERYBODY, Principal
from master.api.request import Answer, Call, PageQuery
from master.graph.records import Connection, Environment, Record, user_of
from master.graph.state import State
from rce.api.views import Page
from rce.errors import NotFound, Unauthorized
from rce.spelling import tags, unknown

R = TypeVar("R", bound=Record)
V = TypeVar("V")


def principal_of(call: Call) -> Principal:
    """Return the principal of a call.

    Raises:
        Unauthorized: The route is public.
    """
    if call.principal is None:
        raise Unauthorized("credentials are missing")
    return call.principal


def authorize(call: Call, operation: str, user: str, *, robot: str = "", environment: str = "") -> str:
    """Return the owner of the resource, `user` or else the caller, if the caller may do this operation on it.

    Raises:
        Forbidden: The caller's role does not allow it.
        NotFound: The resource is another user's, of whom the caller must not learn anything.
    """
    owner = user or call.user
    _check(call, operation, owner, robot, environment)
    return owner


def authorize_platform(call: Call, operation: str) -> None:
    """Check that the caller may do this operation on what belongs to no user, as `authorize` does."""
    _check(call, operation, rights.NOBODY)


def authorize_list(call: Call, operation: str, user: str) -> str:
    """Return whose resources a list has: EVERYBODY stands for all users whose resources the caller may see.

    Raises:
        Forbidden: As `authorize`.
        NotFound: As `authorize`.
    """
    if user == EVERYBODY and rights.reach(principal_of(call), operation) == "own":
        return call.user
    return authorize(call, operation, user)


def find_environment(call: Call, state: State, operation: str, user: str) -> Environment:
    """Return the environment in the path of a call, if the caller may do this operation on it.

    Raises:
        Forbidden: As `authorize`.
        NotFound: As `authorize`, or there is none of this name.
    """
    tag = call.path["environment"]
    owner = authorize(call, operation, user, environment=tag)
    environment = state.environments.get(f"{owner}/{tag}")
    if environment is None:
        known = tags(each.name for each in state.environments.by(owner))
        raise NotFound(unknown("environment", tag, known), field="environment")
    return environment


def _check(call: Call, operation: str, owner: str, robot: str = "", environment: str = "") -> None:
    call.audit.operation, call.audit.owner = operation, owner
    rights.check(principal_of(call), operation, owner, robot=robot, environment=environment)


def page_of_records(
    records: Iterable[R], user: str, page: PageQuery, view: Callable[[R], V], keep: Callable[[V], bool] = lambda _: True
) -> Answer:
    """Return a page of the views of the user's records that `keep` accepts, in the order of their keys."""
    wanted = (each for each in records if each.key > page.after and user in (EVERYBODY, _owner(each)))
    return page_of_views(((each.key, view(each)) for each in wanted), page, keep)


def _owner(record: Record) -> str:
    return record.user if isinstance(record, Connection) else user_of(record.key)


def page_of_views(
    keyed: Iterable[tuple[str, V]], page: PageQuery, keep: Callable[[V], bool] = lambda _: True
) -> Answer:
    """Return a page of views, given with their keys, that `keep` accepts, in the order of the keys."""
    kept = ((key, view) for key, view in keyed if key > page.after and keep(view))
    found = heapq.nsmallest(page.limit + 1, kept, key=lambda pair: pair[0])
    more = len(found) > page.limit
    found = found[: page.limit]
    return Answer(Page([view for _, view in found], found[-1][0] if more else ""))
