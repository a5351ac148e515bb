"""A served Master for the tests that run whole commands."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from tests.support.master.served import PASSWORD, Served, serve


@pytest.fixture
def no_context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Path of a file of contexts that does not exist; no environment variable selects a platform."""
    for name in ("RCE_URL", "RCE_USER", "RCE_KEY", "RCE_CONTEXT", "RCE_PASSWORD"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config" / "rce" / "contexts.json"


@pytest.fixture
async def served(
    reactor: ReactorBase, tmp_path: Path, no_context: Path, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[Served]:
    """A served Master, for a user without contexts whose password is in the environment."""
    monkeypatch.setenv("RCE_PASSWORD", PASSWORD)
    async with serve(reactor, tmp_path) as served:
        yield served
