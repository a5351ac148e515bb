"""Small interface packages, and the type support that the tests of real builds share."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rosidl_adapter", reason="needs ROS 2: pip install '.[ros]'")

from provisioning.typesupport import TypeSupport, build, shipped

TEST_PACKAGE = Path(__file__).parents[1] / "ros" / "Test"
MANIFEST = '<?xml version="1.0"?>\n<package format="3">\n  <name>{name}</name>\n</package>\n'


@pytest.fixture
def make_package(tmp_path: Path) -> Callable[..., Path]:
    """`make_package("pkg", {"msg/A.msg": "int32 a"})` writes a package and returns its directory."""

    def make(name: str, files: dict[str, str], directory: str = "") -> Path:
        root = tmp_path / (directory or name)
        for path, text in {"package.xml": MANIFEST.format(name=name), **files}.items():
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).write_text(text)
        return root

    return make


@pytest.fixture(scope="session")
def compiler() -> None:
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler: install g++ to run this")


@pytest.fixture(scope="session")
def typesupport(compiler: None) -> TypeSupport:
    """Type support of all that ships with RCE and of `Test`, in the cache that `provision test` fills."""
    return build([*shipped(), TEST_PACKAGE])
