"""The wheel, installed without a checkout, contains everything that the platform needs."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from rce.api.http import EntryClient, basic
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.paths import ROOT

PACKAGES = ("rce", "master", "endpoints", "containers", "converters", "provisioning")
WEB = ROOT / "master" / "dashboard" / "web"
TIMEOUT = 300.0  # seconds


def run(*words: str | Path) -> None:
    done = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("wheel")
    pytest.importorskip("hatchling", reason="needs hatchling: pip install '.[dev]'")
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", place, ROOT)
    (made,) = place.glob("*.whl")
    return made


def test_wheel_contains_all_files_of_the_packages(wheel: Path) -> None:
    found = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()]
    there = {path.relative_to(ROOT).as_posix(): path for path in found if "__pycache__" not in path.parts}
    there = {name: path for name, path in there.items() if not name.startswith("rce/cpp/")}  # CMake installs these
    with zipfile.ZipFile(wheel) as file:
        modes = {
            each.filename: each.external_attr >> 16 for each in file.infolist() if ".dist-info" not in each.filename
        }
    assert modes.keys() == there.keys()
    assert [name for name, path in there.items() if path.stat().st_mode & 0o111 and not modes[name] & 0o111] == []


async def test_platform_from_the_wheel(wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Start it from another virtual environment with the same libraries, in an empty directory.

    Topics are not tested, because ROS 2 looks for the types of its wheels in the prefix of Python.
    """
    place, empty = tmp_path / "venv", tmp_path / "empty"
    empty.mkdir()
    await asyncio.to_thread(run, sys.executable, "-m", "venv", "--without-pip", place)
    python = place / "bin" / "python"
    install = ("pip", "--python", python, "install", "-q", "--no-deps", "--no-index", wheel)
    await asyncio.to_thread(run, sys.executable, "-m", *install)
    libraries = place / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages" / "libraries.pth"
    libraries.write_text(sysconfig.get_path("purelib"))
    monkeypatch.chdir(empty)
    directory = tmp_path / "platform"
    directory.mkdir()
    async with RealPlatform(directory, program=str(place / "bin" / "rce")) as platform:
        assert f"{place}/bin/python" in " ".join(platform.processes().values())
        await asyncio.to_thread(check_pages, platform.url)
        async with platform.robot("wheeled") as robot, robot.environment("brain") as brain:
            await brain.set_parameter("gain", 1.5)
    assert list(empty.iterdir()) == []


def check_pages(url: str) -> None:
    entry = EntryClient(url, basic(USER, USER))
    pages = {path.relative_to(WEB).as_posix(): path for path in WEB.rglob("*") if path.is_file()}
    pages["rce/rce.js"] = ROOT / "rce" / "js" / "rce.js"
    assert len(pages) > 20
    for name, path in pages.items():
        with entry.open("GET", f"ui/{name.removesuffix('index.html')}") as answer:
            assert answer.read() == path.read_bytes(), name
