"""Locations of ROS 2 packages."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from provisioning import rosinstall
from rce.errors import NotFound


@pytest.fixture
def prefixes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Two prefixes of AMENT_PREFIX_PATH, without ROS 2 in the prefix of Python."""
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "python"))
    for name in ("first", "second"):
        (tmp_path / name / "share" / "ament_index").mkdir(parents=True)
    words = [str(tmp_path / name) for name in ("first", "second", "missing", "first")]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join([*words, ""]))
    return tmp_path / "first", tmp_path / "second"


def add_package(prefix: Path, name: str, kind: str = "packages") -> Path:
    """Install a package; return its share directory."""
    index = prefix / "share" / "ament_index" / "resource_index" / kind
    index.mkdir(parents=True, exist_ok=True)
    (index / name).touch()
    share = prefix / "share" / name
    share.mkdir(exist_ok=True)
    return share


def test_prefixes_are_listed_once_in_the_order_of_the_path(prefixes: tuple[Path, Path]) -> None:
    assert rosinstall.prefixes() == list(prefixes)


def test_prefix_of_python_comes_last(prefixes: tuple[Path, Path]) -> None:
    (Path(sys.prefix) / "share" / "ament_index").mkdir(parents=True)
    assert rosinstall.prefixes() == [*prefixes, Path(sys.prefix)]


def test_built_type_support_is_no_input(prefixes: tuple[Path, Path]) -> None:
    (prefixes[0] / rosinstall.MARKER).touch()
    assert rosinstall.prefixes() == [prefixes[1]]


def test_package_of_the_first_prefix_is_used(prefixes: tuple[Path, Path]) -> None:
    first, second = prefixes
    add_package(second, "both_msgs")
    only = add_package(second, "own_msgs")
    assert rosinstall.share("own_msgs") == rosinstall.required("own_msgs") == only
    in_first = add_package(first, "both_msgs")
    assert rosinstall.share("both_msgs") == in_first


def test_missing_package_is_reported_with_what_to_do(prefixes: tuple[Path, Path]) -> None:
    assert rosinstall.share("no_msgs") is None
    with pytest.raises(NotFound, match=r"no_msgs is not installed .*pip install"):
        rosinstall.required("no_msgs")


def test_only_packages_with_messages_or_services_are_interface_packages(prefixes: tuple[Path, Path]) -> None:
    first, second = prefixes
    add_package(first, "nodes")
    expected = {"a_msgs": add_package(first, "a_msgs", "rosidl_interfaces")}
    add_package(second, "a_msgs", "rosidl_interfaces")
    expected["b_msgs"] = add_package(second, "b_msgs", "rosidl_interfaces")
    assert rosinstall.interface_packages() == expected


def test_include_path_has_existing_directories_only(prefixes: tuple[Path, Path]) -> None:
    first, second = prefixes
    for name in ("a_msgs", "b_msgs"):
        add_package(first, name)
    (first / "include" / "a_msgs").mkdir(parents=True)
    (second / "include").mkdir()
    assert rosinstall.include_directories() == [first / "include" / "a_msgs", first / "include", second / "include"]
