"""Selection of the files of a directory that are pushed."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.errors import InvalidRequest, NotFound, RceError
from rce.packages import layout
from tests.support.paths import TEST_PACKAGE


def make(root: Path, *files: str) -> Path:
    for name in files:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        package = path.parent.name
        path.write_text(f"<package><name>{package}</name></package>" if path.name == "package.xml" else "text")
    return root


def paths(found: layout.Layout) -> set[str]:
    return {entry.path for entry in found.entries}


def test_source_package() -> None:
    found = layout.read(TEST_PACKAGE)
    assert found.name == "Test"
    assert found.interfaces == [TEST_PACKAGE]
    assert {"Test/package.xml", "Test/scripts/stringEcho.py", "Test/srv/StringEcho.srv"} <= paths(found)
    assert not any("__pycache__" in entry.path for entry in found.entries)


def test_executable_files_are_marked(tmp_path: Path) -> None:
    make(tmp_path / "p", "package.xml", "scripts/talk").joinpath("scripts/talk").chmod(0o700)
    assert {entry.path: entry.executable for entry in layout.read(tmp_path / "p").entries} == {
        "p/package.xml": False,
        "p/scripts/talk": True,
    }


def test_directory_of_several_packages(tmp_path: Path) -> None:
    make(tmp_path, "a/package.xml", "a/a.py", "b/package.xml", "notes/x.txt", ".git/config", "a/.hidden", "a/b.pyc")
    found = layout.read(tmp_path)
    assert paths(found) == {"a/package.xml", "a/a.py", "b/package.xml"}
    assert found.name == tmp_path.name


def test_merged_install_space(tmp_path: Path) -> None:
    make(tmp_path / "ws/install", "share/p/package.xml", "lib/p/talk", "setup.bash", "include/p/p.h")
    found = layout.read(tmp_path / "ws/install")
    assert (found.name, paths(found)) == ("ws", {"share/p/package.xml", "lib/p/talk"})


def test_isolated_install_space_is_merged(tmp_path: Path) -> None:
    make(tmp_path, *(f"{name}/{path}" for name in "pq" for path in (f"share/{name}/package.xml", f"lib/{name}/talk")))
    make(tmp_path, "p/share/common.txt", "q/share/common.txt")
    expected = {"share/p/package.xml", "share/q/package.xml", "lib/p/talk", "lib/q/talk", "share/common.txt"}
    assert paths(layout.read(tmp_path)) == expected
    (tmp_path / "q/share/common.txt").write_text("other")
    with pytest.raises(InvalidRequest, match="differ"):
        layout.read(tmp_path)


@pytest.mark.parametrize("file", ["setup.py", "src/main.cpp", "pyproject.toml", "p/fast.pyx"])
def test_package_that_needs_a_build_is_rejected_unless_as_is(tmp_path: Path, file: str) -> None:
    package = make(tmp_path / "p", "package.xml", file)
    with pytest.raises(InvalidRequest, match=r"rce image build .*p"):
        layout.read(package)
    assert f"p/{file}" in paths(layout.read(package, as_is=True))


@pytest.mark.parametrize(
    ("files", "link", "reason"),
    [
        ([], "", "no ROS package"),
        (["install/p/share/p/package.xml", "src/p/package.xml"], "", "push .*install"),
        (["package.xml"], "/etc/passwd", "outside of"),
        (["package.xml", "data/x"], "data", "link to a directory"),
    ],
)
def test_unusable_directory_is_rejected(tmp_path: Path, files: list[str], link: str, reason: str) -> None:
    package = tmp_path / "p"
    package.mkdir()
    make(package, *files)
    if link:
        (package / "link").symlink_to(link)
    with pytest.raises(RceError, match=reason):
        layout.read(package)


def test_missing_directory_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        layout.read(tmp_path / "none")


def test_package_without_valid_name_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "package.xml").write_text("<package/>")
    with pytest.raises(InvalidRequest, match="no valid <name>"):
        layout.read(tmp_path)
    (tmp_path / "package.xml").write_text("<package")
    with pytest.raises(InvalidRequest, match=r"package\.xml"):
        layout.read(tmp_path)


def test_only_files_that_determine_type_support_are_copied(tmp_path: Path) -> None:
    package = make(tmp_path / "p", "package.xml", "msg/A.msg", "srv/B.srv", "scripts/talk")
    target = tmp_path / "copies"
    target.mkdir()
    copy = layout.copy_interfaces(package, target)
    files = {path.relative_to(copy).as_posix() for path in copy.rglob("*") if path.is_file()}
    assert (copy.name, files) == ("p", {"package.xml", "msg/A.msg", "srv/B.srv"})


def test_type_support_includes_used_packages(tmp_path: Path) -> None:
    package = make(tmp_path / "p", "package.xml")
    (package / "msg").mkdir()
    (package / "msg" / "A.msg").write_text("q/B inner\n")
    prefix = make(tmp_path / "prefix", "python/p/_a.py", "python/q/_b.py", "python/unused/_c.py")
    found = {entry.path for entry in layout.type_support(prefix, [package])}
    assert found == {f"{layout.PYTHON}/p/_a.py", f"{layout.PYTHON}/q/_b.py"}
