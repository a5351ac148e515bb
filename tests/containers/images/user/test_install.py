"""Installation of a user's ROS packages in the build of an image."""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from containers.images.user import install as module
from containers.images.user.install import install


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """Directory into which the build context was copied."""
    here = tmp_path / "context"
    here.mkdir()
    return here


def write(path: Path, text: str = "x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


class Pip:
    """Stand-in for `pip install --report -`, which installs a distribution `demo` with its dependency."""

    def __init__(self, status: int = 0) -> None:
        self.installed: list[str] = []
        self._status = status

    def run(self, command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        assert command[:4] == [sys.executable, "-m", "pip", "install"]
        self.installed.append(Path(command[-1]).name)
        items = [{"metadata": {"name": "demo"}, "requested": True}, {"metadata": {"name": "dep"}, "requested": False}]
        return subprocess.CompletedProcess(command, self._status, json.dumps({"install": items}))

    def distribution(self, name: str) -> Any:
        assert name == "demo", "programs of dependencies are none of the ROS package"
        points = [("talk", "console_scripts"), ("own", "console_scripts"), ("plugin", "other.group")]
        return SimpleNamespace(entry_points=[SimpleNamespace(name=point, group=group) for point, group in points])


@pytest.fixture
def pip(monkeypatch: pytest.MonkeyPatch) -> Pip:
    pip = Pip()
    monkeypatch.setattr(subprocess, "run", pip.run)
    monkeypatch.setattr(module, "distribution", pip.distribution)
    return pip


def test_prefix_is_merged(here: Path, tmp_path: Path) -> None:
    write(here / "prefix/lib/p/talk.py")
    kept = write(tmp_path / "prefix/lib/other/node")
    install(here, tmp_path / "prefix", tmp_path / "modules")
    assert (tmp_path / "prefix/lib/p/talk.py").is_file()
    assert kept.is_file()


def test_type_support_is_merged_into_the_modules(here: Path, tmp_path: Path) -> None:
    write(here / "types/python", sysconfig.get_python_version())
    write(here / "types/modules/demo_msgs/__init__.py")
    kept = write(tmp_path / "modules/std_msgs/__init__.py")
    install(here, tmp_path / "prefix", tmp_path / "modules")
    assert (tmp_path / "modules/demo_msgs/__init__.py").is_file()
    assert kept.is_file()


def test_type_support_of_another_python_is_refused(here: Path, tmp_path: Path) -> None:
    write(here / "types/python", "2.7")
    with pytest.raises(SystemExit, match=r"built for Python 2\.7"):
        install(here, tmp_path / "prefix", tmp_path / "modules")


def test_console_scripts_become_executables_of_the_package(here: Path, tmp_path: Path, pip: Pip) -> None:
    prefix = tmp_path / "prefix"
    write(here / "sources/p/package.xml", "<package/>")
    own = write(prefix / "lib/p/own", "comes with the package")
    install(here, prefix, tmp_path / "modules")
    assert pip.installed == ["p"]
    assert (prefix / "share/p/package.xml").read_text() == "<package/>"
    assert sorted(path.name for path in (prefix / "lib/p").iterdir()) == ["own", "talk"]
    assert (prefix / "lib/p/talk").readlink() == Path(sys.executable).with_name("talk")
    assert own.read_text() == "comes with the package"


def test_package_that_pip_cannot_install_ends_the_build(
    here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(here / "sources/p/package.xml")
    monkeypatch.setattr(subprocess, "run", Pip(status=1).run)
    with pytest.raises(SystemExit, match="pip could not install p"):
        install(here, tmp_path / "prefix", tmp_path / "modules")


def test_context_without_packages_changes_nothing(here: Path, tmp_path: Path) -> None:
    install(here, tmp_path / "prefix", tmp_path / "modules")
    assert not (tmp_path / "prefix").exists()
    assert not (tmp_path / "modules").exists()
