"""Refused commands: their errors, and that they change nothing."""

from __future__ import annotations

import pytest

from rce.errors import (
    AlreadyExists,
    InvalidName,
    InvalidRequest,
    LimitExceeded,
    NoCapacity,
    NotConnectable,
    NotFound,
    RceError,
)
from rce.protocol import messages as m
from tests.support.master.fleet import everything, full, furnished, interface

REFUSED: list[tuple[m.Command, type[RceError], str]] = [
    (m.CreateContainer("brain"), AlreadyExists, "containerTag"),
    (m.CreateContainer("r1"), AlreadyExists, "containerTag"),
    (m.CreateContainer("1st"), InvalidName, "containerTag"),
    (m.CreateContainer(""), InvalidName, "containerTag"),
    (m.CreateContainer("a/b"), InvalidName, "containerTag"),
    (m.CreateContainer("big", m.ContainerData(size=4)), NoCapacity, ""),
    (m.CreateContainer("x", m.ContainerData(specialFeatures=["gpu"])), NoCapacity, ""),
    (m.CreateContainer("x", m.ContainerData(gpus=1)), NoCapacity, "containerData.gpus"),
    (m.CreateContainer("x", m.ContainerData(env={"LD_PRELOAD": "x"})), InvalidRequest, "containerData.env.LD_PRELOAD"),
    (m.CreateContainer("x", m.ContainerData(env={"A": "", "RCE_X": ""})), InvalidRequest, "containerData.env.RCE_X"),
    (m.CreateContainer("x", m.ContainerData(image="mine")), LimitExceeded, "containerData.image"),
    (m.CreateContainer("x", m.ContainerData(groupIP="192.168.1.9")), InvalidRequest, "containerData.groupIP"),
    (m.CreateContainer("x", m.ContainerData(group="g", groupIP="10.0.0.1")), InvalidRequest, "containerData.groupIP"),
    (m.CreateContainer("x", m.ContainerData(group="g", groupIp="1.2.3")), InvalidRequest, "containerData.groupIP"),
    (
        m.CreateContainer("x", m.ContainerData(group="g", groupIP="192.168.1.1")),
        InvalidRequest,
        "containerData.groupIP",
    ),
    (
        m.CreateContainer("x", m.ContainerData(group="g", groupIP="192.168.1.0")),
        InvalidRequest,
        "containerData.groupIP",
    ),
    (
        m.CreateContainer("x", m.ContainerData(group="g", groupIP="192.168.1.255")),
        InvalidRequest,
        "containerData.groupIP",
    ),
    (m.DestroyContainer("nobody"), NotFound, "containerTag"),
    (m.DestroyContainer("r1"), NotFound, "containerTag"),
    (m.AddNode("nobody", "n", "p", "e"), NotFound, "containerTag"),
    (m.AddNode("r1", "n", "p", "e"), NotFound, "containerTag"),
    (m.AddNode("brain", "n-1", "p", "e"), InvalidName, "nodeTag"),
    (m.AddNode("brain", "there", "p", "e"), AlreadyExists, "nodeTag"),
    (m.AddNode("brain", "n", "p"), InvalidRequest, "exe"),
    (m.AddNode("brain", "n", "p", "e", launch="l.launch.py"), InvalidRequest, "launch"),
    (m.AddNode("brain", "n", "p", name="n", launch="l.launch.py"), InvalidRequest, "name"),
    (m.RemoveNode("brain", "nobody"), NotFound, "nodeTag"),
    (m.RemoveNode("nobody", "there"), NotFound, "containerTag"),
    (m.SetParameter("nobody", "rate", 1), NotFound, "containerTag"),
    (m.SetParameter("brain", "rate", 1, "a:b"), InvalidName, "nodeTag"),
    (m.DeleteParameter("brain", "nothing"), NotFound, "name"),
    (m.DeleteParameter("brain", "rate", "there"), NotFound, "name"),
    (m.DeleteParameter("nobody", "rate"), NotFound, "containerTag"),
    (m.AddRecorder("nobody", "box"), NotFound, "containerTag"),
    (m.AddRecorder("brain", "b:x"), InvalidName, "recorderTag"),
    (m.RemoveRecorder("brain", "nothing"), NotFound, "recorderTag"),
    (m.RemoveRecorder("nobody", "box"), NotFound, "containerTag"),
    (interface("r1", "new", "Publisher"), InvalidRequest, "interfaceType"),
    (interface("r1", "new", "PublisherXConverter"), InvalidRequest, "interfaceType"),
    (interface("r1", "new", "PublisherInterface"), NotFound, "endpointTag"),
    (interface("brain", "new", "PublisherConverter"), NotFound, "endpointTag"),
    (interface("nobody", "new", "PublisherForwarder"), NotFound, "endpointTag"),
    (interface("r1", "new tag", "PublisherConverter"), InvalidName, "interfaceTag"),
    (interface("r1", "new", "PublisherConverter", "String"), InvalidRequest, "className"),
    (interface("r1", "pose", "PublisherConverter"), AlreadyExists, "interfaceTag"),
    (m.RemoveInterface("r1", "nothing"), NotFound, "interfaceTag"),
    (m.RemoveInterface("nobody", "pose"), NotFound, "interfaceTag"),
    (m.Connect("r1", "brain/pose"), InvalidRequest, "tagA"),
    (m.Connect("r1/pose", "brain/pose/x"), InvalidName, "tagB (interfaceTag)"),
    (m.Connect("r1/nothing", "brain/pose"), NotFound, "tagA"),
    (m.Connect("r1/pose", "brain/nothing"), NotFound, "tagB"),
    (m.Connect("r1/pose", "r1/pose"), NotConnectable, ""),
    (m.Connect("r1/pose", "brain/pose"), AlreadyExists, ""),
    (m.Connect("brain/pose", "r1/pose"), AlreadyExists, ""),
    (m.Connect("r1/pose", "brain/scans"), NotConnectable, ""),  # two senders
    (m.Connect("r1/pose", "brain/number"), NotConnectable, ""),  # other type
    (m.Connect("r1/pose", "brain/answer"), NotConnectable, ""),  # topic and service
    (m.Connect("r1/ask", "brain/answer2"), NotConnectable, ""),  # a second peer of a provider
    (m.Disconnect("r1/pose", "brain/number"), NotFound, ""),
    (m.Disconnect("r1/nothing", "brain/pose"), NotFound, "tagA"),
]


@pytest.mark.parametrize(("command", "error", "field"), REFUSED, ids=lambda value: getattr(value, "__name__", None))
def test_refused_command_changes_nothing_and_names_the_field(
    command: m.Command, error: type[RceError], field: str
) -> None:
    fleet = full()
    before = everything(fleet.state)
    with pytest.raises(RceError) as raised:
        fleet.do("ann", command)
    assert type(raised.value) is error
    assert raised.value.field == field
    assert everything(fleet.state) == before


@pytest.mark.parametrize(
    "command",
    [
        m.DestroyContainer("brain"),
        m.AddNode("brain", "n", "p", "e"),
        m.RemoveNode("brain", "there"),
        m.SetParameter("brain", "rate", 2),
        m.DeleteParameter("brain", "rate"),
        interface("brain", "new", "PublisherInterface"),
        m.RemoveInterface("brain", "pose"),
        m.Connect("r1/pose", "brain/pose"),
        m.Disconnect("r1/pose", "brain/pose"),
        m.RemoveInterface("../ann/brain", "pose"),
    ],
    ids=lambda command: type(command).__name__,
)
def test_other_users_resources_do_not_exist(command: m.Command) -> None:
    fleet = full()
    before = everything(fleet.state)
    with pytest.raises(NotFound):
        fleet.do("bob", command)
    assert everything(fleet.state) == before


def test_tags_are_unique_per_user() -> None:
    fleet = furnished()
    fleet.do("bob", m.CreateContainer("brain"))
    assert "ann/brain" in fleet.state.environments
    assert "bob/brain" in fleet.state.environments
