"""Fixtures of tests of the execution of plans."""

from __future__ import annotations

import pytest

from tests.support.hand_turned import HandTurnedLoop
from tests.support.master.desk import Desk


@pytest.fixture
def desk(hand: HandTurnedLoop) -> Desk:
    return Desk(hand)
