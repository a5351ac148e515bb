"""Images of users' own packages: build context and installation."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import pytest

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")
pytest.importorskip("rosidl_adapter", reason="needs ROS 2: pip install '.[ros]'")

from containers.images.user.install import install
from provisioning import user_image
from rce.errors import InvalidRequest, NotFound


def names(directory: Path) -> set[str]:
    _, context = user_image.make_context(directory)
    with tarfile.open(fileobj=io.BytesIO(context)) as archive:
        return {member.name for member in archive.getmembers() if member.isfile()}


def package(root: Path, *files: str) -> Path:
    for file in ("package.xml", *files):
        path = root / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"<package><name>{root.name}</name></package>" if file == "package.xml" else "x")
    return root


def test_pip_packages_are_added_as_sources(tmp_path: Path) -> None:
    files = names(package(tmp_path / "p", "setup.py", "p/node.py"))
    assert {"Dockerfile", "install.py", "sources/p/setup.py", "sources/p/p/node.py", "sources/p/package.xml"} <= files
    assert not any(name.startswith("prefix/lib") for name in files)


def test_other_packages_are_added_as_they_are(tmp_path: Path) -> None:
    files = names(package(tmp_path / "p", "scripts/talk.py", "top.py", "data/map.yaml"))
    programs = {"prefix/lib/p/talk.py", "prefix/lib/p/top.py"}
    assert {*programs, "prefix/share/p/package.xml", "prefix/share/p/data/map.yaml"} <= files


@pytest.mark.parametrize("file", ["src/node.cpp", "fast.pyx"])
def test_package_that_needs_a_compiler_is_refused(tmp_path: Path, file: str) -> None:
    with pytest.raises(InvalidRequest, match="no compiler"):
        user_image.make_context(package(tmp_path / "p", file))


def test_install_space_is_refused(tmp_path: Path) -> None:
    package(tmp_path / "share/p", "x")
    with pytest.raises(InvalidRequest, match="rce package push"):
        user_image.make_context(tmp_path)


def test_directory_without_package_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        user_image.make_context(tmp_path)


@pytest.mark.parametrize("name", ["Upper", "a//b", "../x", "a b", "-a"])
def test_invalid_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InvalidRequest, match="not a valid name of an image"):
        user_image.build(package(tmp_path / "p"), name, "rce/base", "")


def test_installation_in_the_image(tmp_path: Path) -> None:
    _, context = user_image.make_context(package(tmp_path / "p", "scripts/talk.py"))
    with tarfile.open(fileobj=io.BytesIO(context)) as archive:
        archive.extractall(tmp_path / "context", filter="data")
    install(tmp_path / "context", tmp_path / "prefix", tmp_path / "modules")
    assert (tmp_path / "prefix/share/p/package.xml").is_file()
    assert (tmp_path / "prefix/lib/p/talk.py").read_text() == "x"
