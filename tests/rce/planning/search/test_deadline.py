"""The clock that stops searches."""

from __future__ import annotations

import threading

import pytest

from rce.planning.failures import NoPath, Reason
from rce.planning.search.deadline import Deadline


def test_flag_is_set_when_the_time_is_over() -> None:
    with Deadline(0.001) as deadline:
        deadline._timer.join(20)
        with pytest.raises(NoPath, match=r"within 0\.001 s") as raised:
            deadline.check()
    assert raised.value.reason is Reason.TIMEOUT


def test_timer_ends_with_the_search() -> None:
    with Deadline(3600) as deadline:
        deadline.check()
        assert deadline.elapsed >= 0
    deadline._timer.join(20)
    assert deadline._timer not in threading.enumerate()
    assert not deadline.flag[0]
