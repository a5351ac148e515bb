"""A guest and a client of the gateway."""

from __future__ import annotations

import pytest

from tests.support.endpoints.fake_guest import FakeGuest, FakePeer


@pytest.fixture
async def guest() -> FakeGuest:
    return FakeGuest()


@pytest.fixture
def peer() -> FakePeer:
    return FakePeer()
