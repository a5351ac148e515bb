"""A running platform is saved and restored in another directory."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

from rce.client import Robot
from tests.support.e2e.real_platform import RCE, USER, RealPlatform, until
from tests.support.paths import ROOT

WEATHER = ROOT / "docs" / "examples" / "weather"


async def rce(*words: str, url: str = "http://127.0.0.1:1/") -> str:
    """Run a command as the user and return its output."""
    variables = os.environ | {"RCE_URL": url, "RCE_USER": USER, "RCE_PASSWORD": USER}
    pipe, both = asyncio.subprocess.PIPE, asyncio.subprocess.STDOUT
    process = await asyncio.create_subprocess_exec(RCE, *words, env=variables, stdout=pipe, stderr=both)
    output = (await process.communicate())[0].decode()
    assert process.returncode == 0, output
    return output


@pytest.fixture
def directories(tmp_path: Path) -> tuple[Path, Path]:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    return first, second


async def test_restored_platform_has_users_keys_packages_and_environments(directories: tuple[Path, Path]) -> None:
    first, second = directories
    file = str(first / "backup.tar")
    async with RealPlatform(first) as platform:
        async with Robot(platform.url, user=USER, robot="r2d2", password=USER) as robot:
            await robot.create_environment("brain")
            await robot.set_parameter("brain", "rate", 10)
        await rce("package", "push", str(WEATHER), "--text-only", url=platform.url)
        key = (await rce("key", "create", url=platform.url)).split()[-1]
        output = await rce("backup", file, "--data-dir", str(first / "data" / "master"))
        assert output == f"{file}: the database, packages: 1, files of settings: 0\n"

    place = ("--data-dir", str(second / "data" / "master"))
    assert (await rce("restore", file, *place)).startswith("restored what RCE ")
    async with RealPlatform(second) as platform:
        await until(lambda: platform.environment_pid("brain"), 60)
        async with Robot(platform.url, user=USER, robot="r2d2", key=key) as robot:
            await robot.set_parameter("brain", "rate", 20)  # the environment is there
        assert "weather" in await rce("package", "list", url=platform.url)
        assert "rate" in await rce("param", "list", "brain", url=platform.url)
