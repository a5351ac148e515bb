"""Which files of a directory are pushed."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce import layout
from rce.errors import InvalidRequest, NotFound, RceError

TEST = Path(__file__).parents[1] / "ros" / "Test"


def make(root: Path, *files: str) -> Path:
    for name in files:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        package = path.parent.name
        path.write_text(f"<package><name>{package}</name></package>" if path.name == "package.xml" else "text")
    return root


def paths(found: layout.Layout) -> set[str]:
    return {entry.path for entry in found.entries}


def test_a_package_that_runs_as_it_is() -> None:
    found = layout.read(TEST)
    assert found.name == "Test"
    assert found.interfaces == [TEST]
    assert {"Test/package.xml", "Test/scripts/stringEcho.py", "Test/srv/StringEcho.srv"} <= paths(found)
    assert not any("__pycache__" in entry.path for entry in found.entries)


def test_executable_or_not(tmp_path: Path) -> None:
    make(tmp_path / "p", "package.xml", "scripts/talk").joinpath("scripts/talk").chmod(0o700)
    assert {entry.path: entry.executable for entry in layout.read(tmp_path / "p").entries} == {
        "p/package.xml": False,
        "p/scripts/talk": True,
    }


def test_several_packages(tmp_path: Path) -> None:
    make(tmp_path, "a/package.xml", "a/a.py", "b/package.xml", "notes/x.txt", ".git/config", "a/.hidden", "a/b.pyc")
    found = layout.read(tmp_path)
    assert paths(found) == {"a/package.xml", "a/a.py", "b/package.xml"}
    assert found.name == tmp_path.name


def test_an_install_space(tmp_path: Path) -> None:
    make(tmp_path / "ws/install", "share/p/package.xml", "lib/p/talk", "setup.bash", "include/p/p.h")
    found = layout.read(tmp_path / "ws/install")
    assert (found.name, paths(found)) == ("ws", {"share/p/package.xml", "lib/p/talk"})


def test_an_isolated_install_space_is_merged(tmp_path: Path) -> None:
    make(tmp_path, *(f"{name}/{path}" for name in "pq" for path in (f"share/{name}/package.xml", f"lib/{name}/talk")))
    make(tmp_path, "p/share/common.txt", "q/share/common.txt")
    expected = {"share/p/package.xml", "share/q/package.xml", "lib/p/talk", "lib/q/talk", "share/common.txt"}
    assert paths(layout.read(tmp_path)) == expected
    (tmp_path / "q/share/common.txt").write_text("other")
    with pytest.raises(InvalidRequest, match="differ"):
        layout.read(tmp_path)


@pytest.mark.parametrize("file", ["setup.py", "src/main.cpp", "pyproject.toml", "p/fast.pyx"])
def test_what_needs_a_build(tmp_path: Path, file: str) -> None:
    package = make(tmp_path / "p", "package.xml", file)
    with pytest.raises(InvalidRequest, match=r"rce image build .*p"):
        layout.read(package)
    assert f"p/{file}" in paths(layout.read(package, as_is=True))


@pytest.mark.parametrize(
    ("files", "link", "reason"),
    [
        ([], "", "no ROS package"),
        (["install/p/share/p/package.xml", "src/p/package.xml"], "", "push .*install"),
        (["package.xml"], "/etc/passwd", "leads out"),
        (["package.xml", "data/x"], "data", "link to a directory"),
    ],
)
def test_what_is_refused(tmp_path: Path, files: list[str], link: str, reason: str) -> None:
    package = tmp_path / "p"
    package.mkdir()
    make(package, *files)
    if link:
        (package / "link").symlink_to(link)
    with pytest.raises(RceError, match=reason):
        layout.read(package)


def test_a_file_that_is_no_directory(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        layout.read(tmp_path / "none")


def test_a_package_without_a_name(tmp_path: Path) -> None:
    (tmp_path / "package.xml").write_text("<package/>")
    with pytest.raises(InvalidRequest, match="no legal <name>"):
        layout.read(tmp_path)
    (tmp_path / "package.xml").write_text("<package")
    with pytest.raises(InvalidRequest, match=r"package\.xml"):
        layout.read(tmp_path)
