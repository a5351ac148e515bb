"""What nobody needs more of. Beside the limits that administrators set: without it one user could fill the Master."""

from __future__ import annotations

from typing import Any

from master.records import Parameter, State, Table
from rce.errors import LimitExceeded
from rce.messages import ParameterValue

NODES = 1000  # of one environment, as are those below
PARAMETERS = 10_000
PARAMETER_TEXT = 16 * 1024 * 1024  # characters and items of lists, in all of its parameters together
INTERFACES = 10_000  # of one robot or environment
SMALL = 1024  # a parameter up to this is held by their number


def check_count(table: Table[Any], owner: str, most: int, field: str) -> None:
    """Refuse one more record of `owner`. LimitExceeded."""
    if table.count(owner) >= most:
        kind = table.kind.__name__.lower()
        raise LimitExceeded(f"{owner.partition('/')[2]} has {most} {kind}s: remove some", field=field, limit=most)


def check_parameter(state: State, parameter: Parameter) -> None:
    """Refuse one that makes too many, or too much, of its environment's. LimitExceeded."""
    if parameter.key not in state.parameters:
        check_count(state.parameters, parameter.owner, PARAMETERS, "name")
    size = _size(parameter.spec.value)
    if size <= SMALL:
        return
    others = (each for each in state.parameters.by(parameter.owner) if each.key != parameter.key)
    if size + sum(_size(each.spec.value) for each in others) > PARAMETER_TEXT:
        raise LimitExceeded(
            f"the parameters of {parameter.owner.partition('/')[2]} would have more than {PARAMETER_TEXT} characters",
            field="value",
            limit=PARAMETER_TEXT,
        )


def _size(value: ParameterValue) -> int:
    if isinstance(value, list):
        return sum(map(_size, value))
    return len(value) if isinstance(value, str) else 1
