"""Definitions of installed types and of the types that they use."""

from pathlib import Path

import pytest

from endpoints.environment.definitions import InstalledTypes
from rce.control.calls.robots import Sort
from rce.errors import UnknownType


@pytest.fixture
def definitions(tmp_path: Path) -> InstalledTypes:
    files = {
        "prefix/share/std_msgs/msg/Header.msg": "string frame_id",
        "prefix/share/a/msg/Outer.msg": "Header h # c/Never\nInner[<=3] in\nb/Other[2] o\nint32 N=3\nstring<=5 s",
        "prefix/share/a/msg/Inner.msg": "bool[] flags\nfloat64 x 1.5",
        "src/b/msg/Other.msg": "b/msg/Deep deep",
        "src/b/msg/Deep.msg": "",
        "src/b/srv/Do.srv": "a/Inner question\n---\nOther answer",
        "src/b/action/Go.action": "a/Inner to\n---\n---\nOther at",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return InstalledTypes([tmp_path / "prefix"], [tmp_path / "src"])


def test_message_includes_types_of_its_fields(definitions: InstalledTypes) -> None:
    names = {"a/msg/Outer", "a/msg/Inner", "b/msg/Other", "b/msg/Deep", "std_msgs/msg/Header"}
    assert set(definitions.describe("a/Outer", "msg")) == names


def test_service_includes_types_of_request_and_response(definitions: InstalledTypes) -> None:
    texts = definitions.describe("b/srv/Do", "srv")
    assert set(texts) == {"b/srv/Do", "a/msg/Inner", "b/msg/Other", "b/msg/Deep"}
    assert texts["b/srv/Do"] == "a/Inner question\n---\nOther answer"


def test_action_includes_types_of_all_parts(definitions: InstalledTypes) -> None:
    assert set(definitions.describe("b/Go", "action")) == {"b/action/Go", "a/msg/Inner", "b/msg/Other", "b/msg/Deep"}


@pytest.mark.parametrize(("name", "sort"), [("a/Nothing", "msg"), ("x/Inner", "msg"), ("a/Inner", "srv")])
def test_unknown_types_are_rejected(definitions: InstalledTypes, name: str, sort: Sort) -> None:
    with pytest.raises(UnknownType):
        definitions.describe(name, sort)
