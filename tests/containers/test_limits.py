"""Limits of an environment: those that it asks for, those of its slots, and what the machine has."""

from __future__ import annotations

from typing import Any

import pytest

from containers.limits import Limits, Size, check, limits
from rce.errors import LimitExceeded
from rce.protocol import slots
from rce.protocol.messages import Rates
from tests.support.containers.engine_contract import spec, with_options

LARGE = Size(64.0, 2**40)


def test_environment_gets_the_share_of_its_slots() -> None:
    assert limits(spec(size=3), [], LARGE) == Limits(3 * slots.MEMORY, 3 * slots.CORES, 3 * slots.PIDS)


def test_share_of_the_slots_is_at_most_the_machine() -> None:
    small = Size(1.5, slots.MEMORY + 1)
    assert limits(spec(size=3), [], small) == Limits(slots.MEMORY + 1, 1.5, 3 * slots.PIDS)


def test_environment_gets_what_it_asks_for() -> None:
    asked = with_options(memory=5000, cpu=0.25, pids=7, io=Rates(read=1, write=2), size=3)
    assert limits(asked, ["0", "2"], LARGE) == Limits(5000, 0.25, 7, Rates(read=1, write=2), ["0", "2"])


@pytest.mark.parametrize(("options", "most"), [({"cpu": 64.5}, 64), ({"memory": 2**40 + 1}, 2**40)])
def test_more_than_the_machine_has_is_refused(options: dict[str, Any], most: float) -> None:
    ((field, asked),) = options.items()
    with pytest.raises(LimitExceeded, match=f"ann/map asks for {field}") as raised:
        limits(with_options(**options), [], LARGE)
    assert raised.value.field == f"containerData.{field}"
    assert raised.value.info.fields == {"asked": asked, "limit": most}


def test_all_that_the_machine_has_is_granted() -> None:
    check(with_options(cpu=LARGE.cores, memory=LARGE.memory), LARGE)


def test_size_of_this_machine() -> None:
    here = Size.here()
    assert here.cores >= 1
    assert here.memory > 2**28
