"""The client's contract at the fake platform."""

from __future__ import annotations

import pytest
from client_contract import ClientContract, Platform
from fake_platform import FakePlatform, FakeWorld


class TestClientAtFake(ClientContract):
    @pytest.fixture
    def platform(self, fake: FakePlatform) -> Platform:
        return FakeWorld(fake)
