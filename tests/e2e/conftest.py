"""Platforms for the end-to-end tests: real processes, real sockets, real ROS 2."""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from real_platform import RealPlatform, containers

from provisioning.typesupport import build, shipped

HERE = Path(__file__).parent
TEST_PACKAGE = HERE.parent / "ros" / "Test"


@pytest.fixture(scope="session")
def arguments() -> list[str]:
    """Where a platform finds the package Test and its types."""
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler for the types of the package Test: install g++ to run this")
    typesupport = build([*shipped(), TEST_PACKAGE])
    packages = f"{TEST_PACKAGE.parent},{HERE / 'ros'}"
    return ["--package-path", packages, "--typesupport", str(typesupport.prefix)]


@pytest.fixture(scope="session")
async def platform(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """One for all tests that leave it as it is; the robots and environments of a test have names of their own."""
    async with RealPlatform(tmp_path_factory.mktemp("platform"), *arguments) as platform:
        yield platform


@pytest.fixture
async def fragile(arguments: list[str], tmp_path: Path) -> AsyncIterator[RealPlatform]:
    """A platform of the test's own, whose parts it may kill."""
    async with RealPlatform(tmp_path, *arguments) as platform:
        yield platform


@pytest.fixture(scope="session")
async def contained(images: Any, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """One with the engine `docker`, for all tests that leave it as it is."""
    async with RealPlatform(tmp_path_factory.mktemp("contained"), "--engine", "docker") as platform:
        yield platform
    assert containers(images, platform) == []
