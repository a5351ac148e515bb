"""Classes of installed types, and the reasons for which there is none."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from std_msgs.msg import String
from std_srvs.srv import SetBool

from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.ros_types import message_class, service_class
from rce.errors import UnknownType

SOURCES = {
    "std_msgs/msg/String.msg": "string data",
    "std_srvs/srv/SetBool.srv": "bool data\n---\nbool success\nstring message",
    "untyped/msg/Thing.msg": "int32 a",
    "untyped/srv/Ask.srv": "---",
    "hollow/msg/Thing.msg": "int32 a",
    "hollow/srv/Ask.srv": "---",
    "hollow/msg/Missing.msg": "int32 a",
}


@pytest.fixture
def definitions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> InstalledTypes:
    """Definitions of which `untyped` has no Python module, and `hollow` a module without type support."""
    for name, text in SOURCES.items():
        file = tmp_path / "src" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    for sort, name in (("msg", "Thing"), ("srv", "Ask")):
        package = tmp_path / "python" / "hollow" / sort
        package.mkdir(parents=True)
        (package / "__init__.py").write_text(f"class {name}: pass\n")
    monkeypatch.syspath_prepend(tmp_path / "python")
    for name in [name for name in sys.modules if name.partition(".")[0] == "hollow"]:
        monkeypatch.delitem(sys.modules, name)
    return InstalledTypes([], [tmp_path / "src"])


@pytest.mark.parametrize("name", ["std_msgs/String", "std_msgs/msg/String"])
def test_message_class_is_found(definitions: InstalledTypes, name: str) -> None:
    assert message_class(name, definitions) is String


@pytest.mark.parametrize("name", ["std_srvs/SetBool", "std_srvs/srv/SetBool"])
def test_service_class_is_found(definitions: InstalledTypes, name: str) -> None:
    assert service_class(name, definitions) is SetBool


def test_type_that_is_not_installed_is_unknown(definitions: InstalledTypes) -> None:
    with pytest.raises(UnknownType, match="check the spelling"):
        message_class("std_msgs/Strong", definitions)
    with pytest.raises(UnknownType):
        service_class("std_msgs/String", definitions)
    with pytest.raises(UnknownType):
        message_class("std_srvs/SetBool", definitions)


def test_module_that_is_no_ros_package_is_not_imported(definitions: InstalledTypes) -> None:
    with pytest.raises(UnknownType, match="check the spelling"):
        message_class("this/That", definitions)
    assert "this" not in sys.modules


@pytest.mark.parametrize("name", ["untyped/Thing", "hollow/Thing", "hollow/Missing"])
def test_message_without_type_support_is_unknown(definitions: InstalledTypes, name: str) -> None:
    with pytest.raises(UnknownType, match="its type support cannot be loaded") as caught:
        message_class(name, definitions)
    assert caught.value.info.field == "className"


@pytest.mark.parametrize("name", ["untyped/Ask", "hollow/Ask"])
def test_service_without_type_support_is_unknown(definitions: InstalledTypes, name: str) -> None:
    with pytest.raises(UnknownType, match="its type support cannot be loaded"):
        service_class(name, definitions)
