"""Commands as frames."""

from __future__ import annotations

import pytest

from rce.client.commands import already_done, frame_of
from rce.errors import AlreadyExists, NotFound
from rce.protocol.messages import (
    AddNode,
    Command,
    Connect,
    ContainerData,
    CreateContainer,
    DestroyContainer,
    Disconnect,
    SetParameter,
)


@pytest.mark.parametrize(
    ("command", "frame"),
    [
        (
            CreateContainer("brain", ContainerData(gpus=1)),
            {"type": "CC", "data": {"containerTag": "brain", "containerData": {"size": 1, "gpus": 1}}},
        ),
        (DestroyContainer("brain"), {"type": "DC", "data": {"containerTag": "brain"}}),
        (
            AddNode("brain", "n", "pkg", "exe"),
            {
                "type": "CN",
                "data": {"addNodes": [{"containerTag": "brain", "nodeTag": "n", "pkg": "pkg", "exe": "exe"}]},
            },
        ),
        (
            SetParameter("brain", "flag", False),
            {"type": "CN", "data": {"setParam": [{"containerTag": "brain", "name": "flag", "value": False}]}},
        ),
        (Connect("a/x", "b/y"), {"type": "CX", "data": {"connect": [{"tagA": "a/x", "tagB": "b/y"}]}}),
    ],
)
def test_frame_has_one_command_without_default_values(command: Command, frame: object) -> None:
    assert frame_of(command) == frame


def test_errors_that_show_an_earlier_execution() -> None:
    assert already_done(Connect("a/x", "b/y"), AlreadyExists(""))
    assert already_done(Disconnect("a/x", "b/y"), NotFound(""))
    assert not already_done(Connect("a/x", "b/y"), NotFound(""))
    assert not already_done(Disconnect("a/x", "b/y"), AlreadyExists(""))
