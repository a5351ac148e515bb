"""Lab: a namespace behind an emulated line."""

from __future__ import annotations

import os

import pytest

from rce.bench.network.lab import lab
from rce.errors import Unavailable


async def test_lab_needs_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(Unavailable, match="need root"):
        async with lab("lte"):
            pass
