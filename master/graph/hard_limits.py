"""Hard limits for every user, independent of policies: they keep one user from exhausting the Master's memory."""

from __future__ import annotations

from typing import Any

from master.graph.records import Connection, Parameter, ParameterValue
from master.graph.state import State, Table, all_of
from rce.errors import LimitExceeded

NODES = 1000  # of one environment, as are those below
PARAMETERS = 10_000
RECORDERS = 16  # each has a thread in the environment, and one in its task set
PARAMETER_TEXT = 16 * 1024 * 1024  # characters and items of lists, in all of its parameters together
INTERFACES = 10_000  # of one robot or environment
WAITING = 1000  # connections of one user that wait for an end that is away
KEEP_ALL = 100  # connections of one user that must not drop: each has a data link of its own
SMALL = 1024  # smaller parameters are bounded by their number alone


def check_count(table: Table[Any], owner: str, most: int, field: str) -> None:
    """Check that `owner` may have one more record.

    Raises:
        LimitExceeded: It has `most` already.
    """
    if table.count(owner) >= most:
        kind = table.kind.__name__.lower()
        raise LimitExceeded(f"{owner.partition('/')[2]} has {most} {kind}s: remove some", field=field, limit=most)


def check_parameter(state: State, parameter: Parameter) -> None:
    """Check number and total size of an environment's parameters with this one.

    Raises:
        LimitExceeded: One of the two is too large.
    """
    if parameter.key not in state.parameters:
        check_count(state.parameters, parameter.owner, PARAMETERS, "name")
    size = _size(parameter.value)
    if size <= SMALL:
        return
    others = (each for each in state.parameters.by(parameter.owner) if each.key != parameter.key)
    if size + sum(_size(each.value) for each in others) > PARAMETER_TEXT:
        raise LimitExceeded(
            f"the parameters of {parameter.owner.partition('/')[2]} would have more than {PARAMETER_TEXT} characters",
            field="value",
            limit=PARAMETER_TEXT,
        )


def keeps_all(state: State, connection: Connection) -> bool:
    """Return True if a connection must not drop messages."""
    return any(state.interfaces[key].qos.history == "keep_all" for key in (connection.sender, connection.receiver))


def check_keep_all(state: State, connection: Connection) -> None:
    """Check that a connection may be added if it must not drop messages.

    Raises:
        LimitExceeded: Its user has `KEEP_ALL` of them already.
    """
    check_lossless(state, connection.user, int(keeps_all(state, connection)))


def check_lossless(state: State, user: str, more: int) -> None:
    """Check that a user may have `more` connections that must not drop messages.

    Raises:
        LimitExceeded: There would be more than `KEEP_ALL`.
    """
    if not more:
        return
    others = state.connections.by(all_of(user))
    if sum(keeps_all(state, each) for each in others) + more > KEEP_ALL:
        raise LimitExceeded(
            f"you have {KEEP_ALL} connections with history keep_all, each of which takes a data link of its own: "
            "use keep_last with a depth, or remove some",
            field="tagA",
            limit=KEEP_ALL,
        )


def _size(value: ParameterValue) -> int:
    if isinstance(value, list):
        return sum(max(1, _size(item)) for item in value)
    if isinstance(value, dict):
        return sum(len(key) + 1 + _size(item) for key, item in value.items())
    return len(value) if isinstance(value, str) else 1
