"""Interface packages, type support, and fake systems."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.paths import TEST_PACKAGE

pytest.importorskip("rosidl_adapter", reason="needs ROS 2: pip install '.[ros]'")

from provisioning.system import System
from provisioning.typesupport import TypeSupport, build, shipped
from tests.support.provisioning.packages import write_package
from tests.support.provisioning.systems import make_system

SYSTEMS = [("debian", "12", "3.11"), ("debian", "13", "3.13"), ("ubuntu", "24.04", "3.12")]


@pytest.fixture
def make_package(tmp_path: Path) -> Callable[..., Path]:
    """`make_package("pkg", {"msg/A.msg": "int32 a"})` writes a package and returns its directory."""

    def make(name: str, files: dict[str, str], directory: str = "") -> Path:
        return write_package(tmp_path / (directory or name), name, files)

    return make


@pytest.fixture(scope="session")
def compiler() -> None:
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler: install g++ to run this")


@pytest.fixture(scope="session")
def typesupport(compiler: None) -> TypeSupport:
    """Type support of the interface packages of RCE and of the tests, in the cache that `provision test` fills."""
    return build([*shipped(), TEST_PACKAGE])


@pytest.fixture
def no_docker(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Let Docker not answer, as on a fresh system. Other tests may run a daemon."""
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/none.sock")


@pytest.fixture(params=SYSTEMS, ids=lambda each: "-".join(each[:2]))
def fresh(request: pytest.FixtureRequest, tmp_path: Path, no_docker: None) -> System:
    return make_system(tmp_path, *request.param)


@pytest.fixture
def debian(tmp_path: Path, no_docker: None) -> System:
    return make_system(tmp_path, "debian", "12", "3.11")


@pytest.fixture
def installed(tmp_path: Path) -> System:
    """System on which all roles are installed."""
    for place in ("etc/rce", "var/lib/rce/master", "opt/rce", "etc/systemd/system", "etc/sysctl.d"):
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "etc/sysctl.d/60-rce.conf").touch()
    for role in ("master", "robot", "container", "map-service", "knowledge-service"):
        (tmp_path / f"etc/rce/{role}.toml").touch()
        (tmp_path / f"etc/systemd/system/rce-{role}.service").touch()
    (tmp_path / "etc/passwd").write_text("rce:x:999:999::/:/bin/false\n")
    return System(tmp_path)
