"""Options of environments under the engine `process`: refused, ignored with a warning, or accepted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from twisted.logger import LogEvent, formatEvent, globalLogPublisher

from containers.process.options import NEVER_ENFORCED, check_options
from rce.errors import InvalidRequest, LimitExceeded
from rce.protocol.messages import Rates
from tests.support.containers.engine_contract import spec, with_options


@pytest.fixture
def logged() -> Iterator[list[str]]:
    lines: list[str] = []

    def observe(event: LogEvent) -> None:
        lines.append(formatEvent(event))

    globalLogPublisher.addObserver(observe)  # type: ignore[arg-type]  # mypy does not know zope's interfaces
    yield lines
    globalLogPublisher.removeObserver(observe)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "error", "field"),
    [
        ({"cpu": 10_000}, LimitExceeded, "containerData.cpu"),
        ({"memory": 2**60}, LimitExceeded, "containerData.memory"),
        ({"image": "mine"}, InvalidRequest, "containerData.image"),
        ({"gpus": 1}, InvalidRequest, "containerData.gpus"),
    ],
)
def test_what_the_machine_or_the_engine_lacks_is_refused(
    options: dict[str, Any], error: type[LimitExceeded | InvalidRequest], field: str
) -> None:
    with pytest.raises(error, match="ann/map") as raised:
        check_options(with_options(**options), [])
    assert raised.value.field == field


def test_limits_that_are_not_enforced_are_accepted_with_a_warning(logged: list[str]) -> None:
    options = with_options(cpu=0.5, memory=1, pids=9, disk=1, bandwidth=1, io=Rates(read=1))
    check_options(options, [*NEVER_ENFORCED, "cpu"])
    assert logged == ["ann/map: the process engine does not enforce bandwidth, cpu, disk, io"]


def test_environment_without_limits_gives_no_warning(logged: list[str]) -> None:
    check_options(spec(size=3), NEVER_ENFORCED)
    assert logged == []
