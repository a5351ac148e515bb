"""Records: their keys and references, and who a robot acts for."""

from __future__ import annotations

import msgspec
import pytest

from master.graph.records import (
    Connection,
    Environment,
    EnvironmentOptions,
    Interface,
    Link,
    Node,
    Package,
    Parameter,
    Process,
    Record,
    Robot,
    ref,
    user_of,
)
from rce.api.roles import Principal

NODE = Node("ann/brain", "echo", "p", "e")


@pytest.mark.parametrize(
    ("record", "key"),
    [
        (Environment("ann/brain", EnvironmentOptions(), "r", "m1"), "ann/brain"),
        (Robot("ann/r1", "west", "s"), "ann/r1"),
        (NODE, "ann/brain/echo"),
        (Parameter("ann/brain", "a/b", 5), "ann/brain/:a/b"),
        (Parameter("ann/brain", "rate", 5, "echo"), "ann/brain/echo:rate"),
        (Interface("0" * 32, "ann/r1", "pose", "SubscriberConverter", "std_msgs/String"), "ann/r1/pose"),
        (Connection("ann/r1/pose", "ann/brain/pose", "link"), "ann/r1/pose ann/brain/pose"),
        (Process("m1", "container", "1"), "m1"),
        (Link("l", "west", "ann/brain", ("1", "2"), ""), "l"),
        (Package("ann/tool"), "ann/tool"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_key_is_a_path_and_begins_with_the_user(record: Record, key: str) -> None:
    assert record.key == key
    assert ref(record) == (type(record).__name__.lower(), key)


def test_references_tell_kinds_apart() -> None:
    parameter = Parameter("ann/brain", "rate", 5, "echo")
    assert str(ref(parameter)) == "parameter ann/brain/echo:rate"
    assert ref(Environment("ann/x", EnvironmentOptions(), "r", "m")) != ref(Robot("ann/x", "west", "s"))


def test_user_is_the_first_part_of_a_name() -> None:
    assert [user_of(name) for name in ("ann/brain/echo", "ann/r1/a ann/r2/b", "m1")] == ["ann", "ann", "m1"]


def test_robot_acts_for_the_identity_that_it_proved() -> None:
    assert Robot("ann/@console", "west", "s", Principal("bob", "operator")).by == Principal("bob", "operator")


def test_stored_robot_without_a_principal_acts_as_a_robot_of_its_user() -> None:
    stored = b'{"name": "ann/r1", "endpoint": "west", "session": "s"}'
    assert msgspec.json.decode(stored, type=Robot).by == Principal("ann", "robot", lent=True)


def test_options_with_their_defaults_are_not_stored() -> None:
    assert msgspec.json.encode(EnvironmentOptions()) == b"{}"
    assert msgspec.json.encode(EnvironmentOptions(size=2)) == b'{"size":2}'
