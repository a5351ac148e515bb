"""The platform of these tests leaves nothing behind, whatever goes wrong in their preparation."""

from __future__ import annotations

from pathlib import Path

import pytest
from real_platform import RealPlatform


async def fail(platform: RealPlatform) -> None:
    async with platform:
        assert platform.processes()
        raise ZeroDivisionError


async def test_a_preparation_that_fails_leaves_no_process(tmp_path: Path) -> None:
    platform = RealPlatform(tmp_path)
    with pytest.raises(ZeroDivisionError):
        await fail(platform)
    assert not platform.processes()


async def test_a_start_that_fails_leaves_no_process(tmp_path: Path) -> None:
    platform = RealPlatform(tmp_path, "--nonsense")
    with pytest.raises(AssertionError, match="nonsense"):
        await fail(platform)
    assert not platform.processes()
