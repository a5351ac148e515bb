"""A user's own package with a type of its own: pushed, run, shared, changed and removed, at a platform without it."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from real_platform import RCE, USER, RealPlatform, until

from rce.client import Environment, Robot
from rce.errors import NotFound, RceError, TimedOut
from rce.http import Entry, basic
from rce.packages import Packages

TEST_PACKAGE = Path(__file__).parents[1] / "ros" / "Test"
OTHER, PASSWORD = "bob", "sailing in winter"
OTHER_NODE = "other.py"
STRING_ECHO = "Test/StringEcho"


def packages(platform: RealPlatform) -> Packages:
    return Packages(Entry(platform.url, basic(USER, USER)))


async def rce(*words: str, given: str = "") -> str:
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(RCE, *words, stdin=pipe, stdout=pipe, stderr=pipe)
    out, errors = await asyncio.wait_for(process.communicate(given.encode()), 150)
    assert process.returncode == 0, errors.decode()
    return out.decode()


@pytest.fixture(scope="module")
async def bare(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """A platform without the package Test and its types; `arguments` has seen to it that these can be built."""
    async with RealPlatform(tmp_path_factory.mktemp("bare"), "--typesupport", "") as platform:
        master = platform.directory / "data" / "master"
        await rce("user", "--data-dir", str(master), "add", OTHER, given=f"{PASSWORD}\n")
        yield platform


def bob(platform: RealPlatform) -> Robot:
    return Robot(platform.url, user=OTHER, robot="r2", password=PASSWORD, timeout=30)


async def echo(environment: Environment) -> None:
    """Call the node's service; its type is known by the package alone."""
    assert await answer(environment, "/stringEchoService", STRING_ECHO, {"data": "hello"}) == {"data": "hello"}


async def answer(environment: Environment, name: str, type_name: str, request: dict[str, str]) -> Any:
    """Of a service whose node may just be starting, on a busy machine."""
    service = await environment.service_client(name, type_name)
    async with asyncio.timeout(120):
        while True:
            try:
                found = await service.call(request)
                await service.close()
                return found
            except NotFound as error:
                if "has not appeared" not in str(error):
                    raise
            except TimedOut:
                pass  # DDS may lose the first answer of a service that has just found its client


def archives(platform: RealPlatform) -> set[str]:
    return {path.name for path in (platform.directory / "data/master/packages").iterdir()} - {"incoming"}


async def test_the_life_of_a_package(bare: RealPlatform, tmp_path: Path) -> None:
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
                assert len(archives(bare)) == 2  # the older is in use

                await echo(theirs)
                before = _endpoint(bare, "theirs")
                bare.kill(before)  # in its next life it has the same version
                await until(lambda: _endpoint(bare, "theirs", before) != 0, 60)
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


def _endpoint(platform: RealPlatform, tag: str, but: int = 0) -> int:
    wanted = f"RCE_NAME={OTHER}/{tag}\0".encode()
    for pid, words in platform.processes().items():
        if pid != but and "endpoints.environment" in words and wanted in Path(f"/proc/{pid}/environ").read_bytes():
            return pid
    return 0


async def test_what_is_refused(bare: RealPlatform, tmp_path: Path) -> None:
    (tmp_path / "p").mkdir()
    (tmp_path / "p/package.xml").write_text("<package><name>p</name></package>")
    (tmp_path / "p/setup.py").touch()
    with pytest.raises(AssertionError, match="rce image build"):
        await rce("package", "push", str(tmp_path / "p"), "--url", bare.url)
    async with bare.robot("r1") as robot:
        with pytest.raises(RceError, match="write it as name"):
            await robot.create_environment("e", packages=["../../etc"])
