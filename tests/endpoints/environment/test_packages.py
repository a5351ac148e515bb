"""Packages of nodes and their executables."""

import platform
import sys
from pathlib import Path

import pytest

from endpoints.environment.packages import SHIPPED, Packages
from endpoints.environment.process_environment import node_variables, python_paths
from endpoints.environment.settings import Settings
from rce.errors import InvalidName, NotFound


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """Install prefix with package `walk`, which has an executable."""
    place = tmp_path / "prefix"
    (place / "share" / "walk").mkdir(parents=True)
    (place / "share" / "walk" / "package.xml").touch()
    (place / "lib" / "walk").mkdir(parents=True)
    _program(place / "lib" / "walk" / "legs", 0o755)
    return place


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """Directory of sources with package `talk`, which has nodes in several directories."""
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


def test_installed_executable_is_found(prefix: Path) -> None:
    assert Packages([prefix], []).command("walk", "legs") == [str(prefix / "lib" / "walk" / "legs")]


@pytest.mark.parametrize(
    ("first", "by_our_python"),
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
def test_python_of_another_machine_is_replaced(prefix: Path, first: str, by_our_python: bool) -> None:
    program = prefix / "lib" / "walk" / "legs"
    program.write_text(f"{first}print()\n")
    assert Packages([prefix], []).command("walk", "legs") == [
        *([sys.executable] if by_our_python else []),
        str(program),
    ]


def test_modules_of_pushed_packages_are_importable(tmp_path: Path, prefix: Path) -> None:
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    built = prefix / f"{version}-{platform.machine()}"
    installed = prefix / "lib" / version / "site-packages"
    for directory in (built, installed, prefix / "python2.7-x86_64", prefix / "lib/python2.7/site-packages"):
        directory.mkdir(parents=True)
    settings = Settings("ann/e", "0" * 32, "", "", tmp_path, package_path=[prefix], typesupport=[Path("/types")])
    assert python_paths(settings) == ["/types/python", str(built), str(installed)]
    variables = node_variables(settings, {"LD_LIBRARY_PATH": "/ros/lib"})
    assert variables["LD_LIBRARY_PATH"] == f"{prefix}/lib:/ros/lib"
    assert variables["PYTHONPATH"].split(":")[1:3] == [str(built), str(installed)]


def test_root_can_be_install_prefix(prefix: Path) -> None:
    assert Packages([], [prefix]).share("walk") == prefix / "share" / "walk"


@pytest.mark.parametrize("name", ["chat", "chat.py"])
def test_source_executable_is_found_with_and_without_suffix(sources: Path, name: str) -> None:
    assert Packages([], [sources]).command("talk", name) == [str(sources / "talk" / "scripts" / "chat.py")]


def test_python_file_without_execute_permission_is_run_by_our_python(sources: Path) -> None:
    path = str(sources / "talk" / "nodes" / "mute.py")
    assert Packages([], [sources]).command("talk", "mute") == [sys.executable, path]


def test_executables_are_listed_by_package_without_modules(prefix: Path, sources: Path) -> None:
    (prefix / "share" / "empty").mkdir()
    (prefix / "share" / "empty" / "package.xml").touch()
    (sources / "talk" / "talk" / "module.py").touch()
    found = Packages([prefix], [sources]).executables()
    assert {name: found[name] for name in ("talk", "walk")} == {"talk": ["chat.py", "mute.py"], "walk": ["legs"]}
    assert "empty" not in found
    assert found["rce_demo"] == ["echo.py"]


def test_other_file_needs_execute_permission(sources: Path) -> None:
    with pytest.raises(NotFound, match="chmod"):
        Packages([], [sources]).command("talk", "plain")


def test_missing_names_are_reported_with_existing_ones(sources: Path) -> None:
    packages = Packages([], [sources])
    with pytest.raises(NotFound, match=r"no package run in .*src"):
        packages.command("run", "chat")
    with pytest.raises(NotFound, match=r"no executable sing; it has chat\.py, mute\.py"):
        packages.command("talk", "sing")


@pytest.mark.parametrize(
    ("package", "executable"), [("../talk", "chat"), ("talk", "../scripts/chat.py"), ("talk", "..")]
)
def test_paths_out_of_package_are_rejected(sources: Path, package: str, executable: str) -> None:
    with pytest.raises(InvalidName):
        Packages([], [sources]).command(package, executable)


def test_shipped_packages_are_always_available() -> None:
    assert SHIPPED in Packages([], []).sources


def test_asset_is_a_file_within_its_package(sources: Path) -> None:
    packages = Packages([], [sources])
    (sources / "talk" / "meshes").mkdir()
    (sources / "talk" / "meshes" / "arm.stl").write_text("mesh")
    (sources / "secret").write_text("secret")
    (sources / "talk" / "link").symlink_to(sources / "secret")
    assert packages.asset("talk", "meshes/arm.stl").read_text() == "mesh"
    assert packages.asset("talk", "meshes/../meshes/arm.stl").read_text() == "mesh"
    for path in ("../secret", "link", str(sources / "secret"), "meshes", "none", "", "\0", 5000 * "x"):
        with pytest.raises(NotFound, match="no file"):
            packages.asset("talk", path)
    with pytest.raises(InvalidName):
        packages.asset("../talk", "package.xml")
