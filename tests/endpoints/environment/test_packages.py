"""Where nodes are found."""

import platform
import sys
from pathlib import Path

import pytest

from endpoints.environment.packages import SHIPPED, Packages
from endpoints.environment.settings import Settings
from endpoints.environment.surroundings import for_nodes, python_paths
from rce.errors import InvalidName, NotFound


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """A prefix as ROS 2 installs: package `walk` with an executable."""
    place = tmp_path / "prefix"
    (place / "share" / "walk").mkdir(parents=True)
    (place / "share" / "walk" / "package.xml").touch()
    (place / "lib" / "walk").mkdir(parents=True)
    _program(place / "lib" / "walk" / "legs", 0o755)
    return place


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A directory of sources: package `talk` with nodes in several places."""
    package = tmp_path / "src" / "talk"
    for directory in ("scripts", "nodes", "talk"):
        (package / directory).mkdir(parents=True)
    (package / "package.xml").touch()
    _program(package / "scripts" / "chat.py", 0o755)
    _program(package / "nodes" / "mute.py", 0o644)
    _program(package / "talk" / "plain", 0o644)
    return package.parent


def _program(path: Path, mode: int) -> None:
    path.write_text("#!/usr/bin/env python3\n")
    path.chmod(mode)


def test_installed_executable(prefix: Path) -> None:
    assert Packages([prefix], []).command("walk", "legs") == [str(prefix / "lib" / "walk" / "legs")]


@pytest.mark.parametrize(
    ("first", "by_us"),
    [
        ("#!/usr/bin/python3\n", True),
        ("#!/home/ann/venv/bin/python3.12\n", True),
        ("#! /usr/bin/python\n", True),
        ("#!/usr/bin/env python3\n", False),
        ("#!/bin/sh\n", False),
        ("#!/usr/bin/python3 -u\n", False),
        ("\x7fELF", False),
    ],
)
def test_a_python_of_another_machine_means_ours(prefix: Path, first: str, by_us: bool) -> None:
    program = prefix / "lib" / "walk" / "legs"
    program.write_text(f"{first}print()\n")
    assert Packages([prefix], []).command("walk", "legs") == [*([sys.executable] if by_us else []), str(program)]


def test_modules_of_pushed_packages_are_found(tmp_path: Path, prefix: Path) -> None:
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    built = prefix / f"{version}-{platform.machine()}"
    installed = prefix / "lib" / version / "site-packages"
    for directory in (built, installed, prefix / "python2.7-x86_64", prefix / "lib/python2.7/site-packages"):
        directory.mkdir(parents=True)
    settings = Settings("ann/e", "0" * 32, "", "", tmp_path, package_path=[prefix], typesupport=[Path("/types")])
    assert python_paths(settings) == ["/types/python", str(built), str(installed)]
    variables = for_nodes(settings, {"LD_LIBRARY_PATH": "/ros/lib"})
    assert variables["LD_LIBRARY_PATH"] == f"{prefix}/lib:/ros/lib"
    assert variables["PYTHONPATH"].split(":")[1:3] == [str(built), str(installed)]


def test_a_root_may_be_a_prefix(prefix: Path) -> None:
    assert Packages([], [prefix]).share("walk") == prefix / "share" / "walk"


@pytest.mark.parametrize("name", ["chat", "chat.py"])
def test_source_executable_with_and_without_ending(sources: Path, name: str) -> None:
    assert Packages([], [sources]).command("talk", name) == [str(sources / "talk" / "scripts" / "chat.py")]


def test_a_python_file_that_is_not_executable_is_run_by_our_python(sources: Path) -> None:
    path = str(sources / "talk" / "nodes" / "mute.py")
    assert Packages([], [sources]).command("talk", "mute") == [sys.executable, path]


def test_another_file_must_be_executable(sources: Path) -> None:
    with pytest.raises(NotFound, match="chmod"):
        Packages([], [sources]).command("talk", "plain")


def test_what_is_not_there_is_named_with_what_is(sources: Path) -> None:
    packages = Packages([], [sources])
    with pytest.raises(NotFound, match=r"no package run.*src"):
        packages.command("run", "chat")
    with pytest.raises(NotFound, match=r"no executable sing; it has chat\.py, mute\.py"):
        packages.command("talk", "sing")


@pytest.mark.parametrize(
    ("package", "executable"), [("../talk", "chat"), ("talk", "../scripts/chat.py"), ("talk", "..")]
)
def test_no_way_out_of_a_package(sources: Path, package: str, executable: str) -> None:
    with pytest.raises(InvalidName):
        Packages([], [sources]).command(package, executable)


def test_shipped_nodes_are_always_known() -> None:
    assert SHIPPED in Packages([], []).sources
