"""Fixtures of tests of the execution of plans."""

from __future__ import annotations

import pytest

from tests.support.master.desk import Desk
from tests.support.master.hand_turned import HandTurnedLoop


@pytest.fixture
def desk(hand: HandTurnedLoop) -> Desk:
    return Desk(hand)
