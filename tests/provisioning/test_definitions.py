"""Malformed packages are refused with file and line before anything is built."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from provisioning.definitions import Reference, read_packages
from rce.errors import AlreadyExists, InvalidName, InvalidRequest, RceError, UnknownType

MakePackage = Callable[..., Path]


@pytest.mark.parametrize(
    ("files", "error", "where", "words"),
    [
        ({"msg/A.msg": "# fine\nint32 a\nint32\n"}, InvalidRequest, "msg/A.msg:3", "'int32' is not a field"),
        ({"msg/A.msg": "int32 a\nInt99 b\n"}, UnknownType, "msg/A.msg:2", "own/Int99"),
        ({"msg/A.msg": "int32 a\nint99 b\n"}, InvalidRequest, "msg/A.msg:2", "'int99 b' is not a field"),
        ({"msg/A.msg": "int32 9a\n"}, InvalidRequest, "msg/A.msg:1", "'int32 9a' is not a field"),
        ({"msg/A.msg": "string[] a ['b', ]\n"}, InvalidRequest, "msg/A.msg:1", "is not a field"),
        ({"msg/A.msg": " b c\n"}, InvalidRequest, "msg/A.msg:1", "'b c' is not a field"),
        ({"msg/A.msg": "int8 a 300\n"}, InvalidRequest, "msg/A.msg:1", "300"),
        ({"msg/A.msg": "int32 a\n\nbool a\n"}, InvalidRequest, "msg/A.msg:3", "a is declared twice"),
        ({"msg/A.msg": "int32 a\nint32 class\n"}, InvalidRequest, "msg/A.msg:2", "class"),
        ({"msg/A.msg": "string[<=x] a\n"}, InvalidRequest, "msg/A.msg:1", "string[<=x] a"),
        ({"srv/A.srv": "int32 a\n---\nint32\n"}, InvalidRequest, "srv/A.srv:3", "'int32' is not a field"),
        ({"srv/A.srv": "int32 a\n"}, InvalidRequest, "srv/A.srv", "one line ---"),
        ({"srv/A.srv": "---\n---\n"}, InvalidRequest, "srv/A.srv", "one line ---"),
        ({"msg/A.msg": "int32 a\nnowhere/B b\n"}, UnknownType, "msg/A.msg:2", "nowhere/B"),
        ({"msg/A.msg": "geometry_msgs/Nothing b\n"}, UnknownType, "msg/A.msg:1", "geometry_msgs/Nothing"),
        ({"msg/A.msg": "B[] b\n"}, UnknownType, "msg/A.msg:1", "own/B"),
        ({"msg/a.msg": "int32 a\n"}, InvalidName, "msg/a.msg", "capital letter"),
        ({"msg/FOOBar.msg": "", "msg/FooBar.msg": ""}, AlreadyExists, "msg/FooBar.msg", "FOOBar.msg"),
        ({}, InvalidRequest, "own", "neither msg/*.msg nor srv/*.srv"),
        (
            {"msg/A.msg": "", "package.xml": "<package>\n<name>own</name>\n"},
            InvalidRequest,
            "package.xml:3",
            "no element",
        ),
        ({"msg/A.msg": "", "package.xml": "<package/>"}, InvalidName, "package.xml", "not a legal package name"),
    ],
)
def test_malformed_package_is_refused(
    make_package: MakePackage, files: dict[str, str], error: type[RceError], where: str, words: str
) -> None:
    root = make_package("own", files)
    with pytest.raises(error) as caught:
        read_packages([root])
    assert str(root.parent / "own" / where if where != "own" else root) in str(caught.value)
    assert words in str(caught.value)


def test_directory_without_package_xml_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"package\.xml does not exist"):
        read_packages([tmp_path])


@pytest.mark.parametrize("name", ["std_msgs", "numpy", "json"])
def test_name_of_an_installed_module_is_refused(make_package: MakePackage, name: str) -> None:
    with pytest.raises(AlreadyExists, match=f"the name {name} is used"):
        read_packages([make_package(name, {"msg/A.msg": ""})])


def test_duplicate_name_is_refused(make_package: MakePackage) -> None:
    roots = [make_package(name, {"msg/A.msg": ""}, directory=name + "_dir") for name in ("own", "Own")]
    with pytest.raises(AlreadyExists, match="Own"):
        read_packages(roots)


def test_dependencies_come_first(make_package: MakePackage) -> None:
    top = make_package("alpha", {"msg/A.msg": "beta/B b\nstd_msgs/Header header\n"})
    bottom = make_package("beta", {"msg/B.msg": "int32 b\n"})
    packages = read_packages([top, bottom])
    assert [package.name for package in packages] == ["beta", "alpha"]
    assert packages[1].uses == {Reference("beta", "B"), Reference("std_msgs", "Header")}


def test_circular_dependencies_are_refused(make_package: MakePackage) -> None:
    roots = [make_package("alpha", {"msg/A.msg": "beta/B b"}), make_package("beta", {"msg/B.msg": "alpha/A a"})]
    with pytest.raises(InvalidRequest, match="depend on each other"):
        read_packages(roots)


def test_names_of_ros_1_are_accepted(make_package: MakePackage) -> None:
    [package] = read_packages([make_package("Own", {"msg/A.msg": "Own/B recipeUID\nB b\n", "msg/B.msg": "bool aB\n"})])
    assert package.interfaces[0].references == {Reference("Own", "B"): 1}


def test_action_has_three_sections(make_package: MakePackage) -> None:
    [package] = read_packages([make_package("own", {"action/Go.action": "int32 a\n---\nint32 a\n---\nint32 a\n"})])
    assert [each.path.name for each in package.interfaces] == ["Go.action"]
    with pytest.raises(InvalidRequest, match="an action has two lines --- between goal, result and feedback, not 1"):
        read_packages([make_package("other", {"action/Go.action": "---\n"})])


def test_idl_is_left_out(make_package: MakePackage) -> None:
    root = make_package("own", {"msg/A.msg": "", "msg/B.idl": ""})
    [package] = read_packages([root])
    assert package.left_out == (root / "msg" / "B.idl",)
