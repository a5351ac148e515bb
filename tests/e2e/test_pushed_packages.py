"""A user's package with its own type, on a platform that lacks it: pushed, run, shared, changed, removed."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rce.api.http import EntryClient, basic
from rce.client import Robot
from rce.errors import NotFound, RceError
from rce.packages.client import PackagesClient
from tests.support.e2e.pushed_packages import echo, rce
from tests.support.e2e.real_platform import USER, RealPlatform, until
from tests.support.paths import TEST_PACKAGE

OTHER, PASSWORD = "bob", "sailing in winter"
OTHER_NODE = "other.py"


def packages(platform: RealPlatform) -> PackagesClient:
    return PackagesClient(EntryClient(platform.url, basic(USER, USER)))


@pytest.fixture(scope="module")
async def bare(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """A platform without the package Test and its types. `arguments` skips the test if they cannot be built."""
    async with RealPlatform(tmp_path_factory.mktemp("bare"), "--typesupport", "") as platform:
        master = platform.directory / "data" / "master"
        await rce("user", "--data-dir", str(master), "add", OTHER, stdin=f"{PASSWORD}\n")
        yield platform


def bob(platform: RealPlatform) -> Robot:
    return Robot(platform.url, user=OTHER, robot="r2", password=PASSWORD, timeout=60)


def archives(platform: RealPlatform) -> set[str]:
    return {path.name for path in (platform.directory / "data/master/packages").iterdir()} - {"incoming"}


async def test_package_is_pushed_shared_changed_and_removed(bare: RealPlatform, tmp_path: Path) -> None:
    url = ("--url", bare.url)
    own = packages(bare)
    said = await rce("package", "push", str(TEST_PACKAGE), *url)
    assert said.startswith(f"{USER}/Test@")
    async with bare.robot("r1") as ann, bob(bare) as other:
        async with ann.environment("mine", packages=["Test"]) as mine:
            await mine.add_node("echo", "Test", "stringEcho.py")
            await echo(mine)

            for wanted in ("Test", f"{USER}/Test", said.split(":")[0]):
                with pytest.raises(NotFound, match=r"no package .*Test that you may use"):
                    await other.create_environment("theirs", packages=[wanted])

            await asyncio.to_thread(own.share, "Test", [OTHER])
            async with other.environment("theirs", packages=[f"{USER}/Test"]) as theirs:
                await theirs.add_node("echo", "Test", "stringEcho.py")
                await echo(theirs)

                await asyncio.to_thread(own.unshare, "Test", [])
                changed = tmp_path / "Test"
                shutil.copytree(TEST_PACKAGE, changed)
                shutil.copy(changed / "scripts/stringEcho.py", changed / "scripts" / OTHER_NODE)
                await rce("package", "push", str(changed), *url)
                (listed,) = await asyncio.to_thread(own.list)
                older, _ = listed.versions
                await asyncio.to_thread(own.remove, "Test", older.digest)
                assert len(archives(bare)) == 2  # the older version is in use

                await echo(theirs)
                before = bare.environment_pid("theirs", user=OTHER)
                bare.kill(before)  # it restarts with the same version
                await until(lambda: bare.environment_pid("theirs", before, OTHER))
                await echo(theirs)
                for environment in (mine, theirs):
                    with pytest.raises(NotFound, match=f"no executable {OTHER_NODE}"):
                        await environment.add_node("newer", "Test", OTHER_NODE)
                with pytest.raises(NotFound):
                    await other.create_environment("again", packages=[f"{USER}/Test"])
        async with ann.environment("newer", packages=["Test"]) as newer:
            await newer.add_node("echo", "Test", OTHER_NODE)
            await echo(newer)
        await until(lambda: len(archives(bare)) == 1, what="the older archive is removed")
        await asyncio.to_thread(own.remove, "Test")
        await until(lambda: not archives(bare))
        with pytest.raises(NotFound):
            await ann.create_environment("mine", packages=["Test"])


async def test_unsuitable_packages_are_refused(bare: RealPlatform, tmp_path: Path) -> None:
    (tmp_path / "p").mkdir()
    (tmp_path / "p/package.xml").write_text("<package><name>p</name></package>")
    (tmp_path / "p/setup.py").touch()
    with pytest.raises(AssertionError, match="rce image build"):
        await rce("package", "push", str(tmp_path / "p"), "--url", bare.url)
    async with bare.robot("r1") as robot:
        with pytest.raises(RceError, match="write it as name"):
            await robot.create_environment("e", packages=["../../etc"])
