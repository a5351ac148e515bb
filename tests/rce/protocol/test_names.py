"""Naming rules of the protocol."""

import pytest

from rce.errors import InvalidName, InvalidRequest
from rce.protocol.names import MAX_TAG, check_tag, parse_type, split_interface


@pytest.mark.parametrize("tag", ["a", "Z", "r2d2", "my_robot", "A" * MAX_TAG])
def test_legal_tags(tag: str) -> None:
    assert check_tag(tag, "robotID") == tag


@pytest.mark.parametrize(
    "tag", ["", "1a", "_a", "a-b", "a b", "a/b", "a\n", "ä", "aä", "a٣", "a.b", "A" * (MAX_TAG + 1)]
)
def test_illegal_tags(tag: str) -> None:
    with pytest.raises(InvalidName) as raised:
        check_tag(tag, "robotID")
    assert raised.value.field == "robotID"
    assert len(str(raised.value)) < 300


@pytest.mark.parametrize("text", ["std_msgs/String", "std_msgs/msg/String", "std_msgs/srv/String"])
def test_all_spellings_of_a_type_are_equal(text: str) -> None:
    name = parse_type(text)
    assert (str(name), name.msg, name.srv) == ("std_msgs/String", "std_msgs/msg/String", "std_msgs/srv/String")


@pytest.mark.parametrize(
    "text",
    ["", "String", "/String", "a/", "a/b/c", "a/action/", "a/msg/", "a/msg/B/c", "a/B\n", "1a/B", "a/" + "B" * 254],
)
def test_malformed_types_are_refused(text: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        parse_type(text)
    assert raised.value.field == "className"


def test_interface_tag_is_split() -> None:
    assert split_interface("r2d2/pose", "tagA") == ("r2d2", "pose")


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("pose", "tagA"),
        ("", "tagA"),
        ("/pose", "tagA (endpointTag)"),
        ("r2d2/", "tagA (interfaceTag)"),
        ("a/b/c", "tagA (interfaceTag)"),
    ],
)
def test_malformed_interface_tags_are_refused(text: str, field: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        split_interface(text, "tagA")
    assert raised.value.field == field
