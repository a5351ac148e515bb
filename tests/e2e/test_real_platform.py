"""`RealPlatform` leaves no processes behind when a test fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.e2e.real_platform import RealPlatform


async def fail(platform: RealPlatform) -> None:
    async with platform:
        assert platform.processes()
        raise ZeroDivisionError


async def test_failed_test_leaves_no_process(tmp_path: Path) -> None:
    platform = RealPlatform(tmp_path)
    with pytest.raises(ZeroDivisionError):
        await fail(platform)
    assert not platform.processes()


async def test_failed_start_leaves_no_process(tmp_path: Path) -> None:
    platform = RealPlatform(tmp_path, "--nonsense")
    with pytest.raises(AssertionError, match="nonsense"):
        await fail(platform)
    assert not platform.processes()
