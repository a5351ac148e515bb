"""Platforms for the end-to-end tests: real processes, real sockets, real ROS 2."""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.paths import TEST_PACKAGE, TESTS

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from provisioning.typesupport import build, shipped
from tests.support.e2e.real_platform import RealPlatform, containers


@pytest.fixture(scope="session")
def arguments() -> list[str]:
    """Options by which a platform finds the packages of the tests and their types."""
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler for the types of the package Test: install g++ to run this")
    typesupport = build([*shipped(), TEST_PACKAGE])
    packages = f"{TEST_PACKAGE.parent},{TESTS / 'e2e' / 'ros'}"
    return ["--package-path", packages, "--typesupport", str(typesupport.prefix)]


@pytest.fixture(scope="session")
async def platform(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """A platform that tests share. Each has its own names for robots and environments, and stops no process."""
    async with RealPlatform(tmp_path_factory.mktemp("platform"), *arguments) as platform:
        yield platform


@pytest.fixture
async def fragile(arguments: list[str], tmp_path: Path) -> AsyncIterator[RealPlatform]:
    """A platform of one test, which may kill its processes."""
    async with RealPlatform(tmp_path, *arguments) as platform:
        yield platform


@pytest.fixture(scope="session")
async def contained(images: Any, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """A platform with the engine `docker` that tests share."""
    async with RealPlatform(tmp_path_factory.mktemp("contained"), "--engine", "docker") as platform:
        yield platform
    assert containers(images, platform) == []
