"""Packages of the build type ament_python become a prefix, as `colcon build` leaves them."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from rce.errors import InvalidRequest, StartFailed
from rce.packages import layout
from rce.packages.ament_python import install
from tests.support.ament_package import make_ament_package

pytestmark = [pytest.mark.slow, pytest.mark.skipif(find_spec("setuptools") is None, reason="needs setuptools")]


def test_package_is_installed_with_executables_resources_and_data(tmp_path: Path) -> None:
    prefix = install(make_ament_package(tmp_path / "ws"), tmp_path / "scratch")
    found = layout.read(prefix)
    names = {entry.path for entry in found.entries}
    assert found.name == "talking"
    assert {
        "lib/talking/talker",
        "share/talking/package.xml",
        "share/talking/launch/talker.launch.py",
        "share/talking/config/text.txt",
        "share/ament_index/resource_index/packages/talking",
    } <= names
    assert any(name.endswith("site-packages/talking/talker.py") for name in names)
    assert next(entry for entry in found.entries if entry.path == "lib/talking/talker").executable


def test_workspace_of_several_packages_is_installed_into_one_prefix(tmp_path: Path) -> None:
    for name in ("one", "two"):
        make_ament_package(tmp_path / "ws", name)
    names = {entry.path for entry in layout.read(install(tmp_path / "ws", tmp_path / "scratch")).entries}
    assert {"lib/one/talker", "lib/two/talker"} <= names


@pytest.mark.parametrize(
    ("target", "reason"),
    [("talking.talker:mian", "talking.talker has no mian"), ("talking.taker:main", "there is no module talking.taker")],
)
def test_entry_point_that_starts_nothing_is_an_error(tmp_path: Path, target: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=f"entry point talker of talking .*{reason}"):
        install(make_ament_package(tmp_path, target=target), tmp_path / "scratch")


def test_other_packages_are_left_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "setup.py").touch()
    (tmp_path / "package.xml").write_text("<package><name>p</name></package>")
    assert install(tmp_path, tmp_path / "scratch") == tmp_path


def test_packages_of_several_kinds_are_refused(tmp_path: Path) -> None:
    make_ament_package(tmp_path / "ws")
    (tmp_path / "ws" / "plain").mkdir()
    (tmp_path / "ws" / "plain" / "package.xml").write_text("<package><name>plain</name></package>")
    with pytest.raises(InvalidRequest, match="plain cannot be pushed together"):
        install(tmp_path / "ws", tmp_path / "scratch")


def test_reason_of_pip_is_passed_on(tmp_path: Path) -> None:
    package = make_ament_package(tmp_path)
    (package / "setup.py").write_text("raise SystemExit('no such wheel')")
    with pytest.raises(StartFailed, match=r"(?s)pip cannot install talking:.*no such wheel"):
        install(package, tmp_path / "scratch")
