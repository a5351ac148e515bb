"""The record of a robot's interfaces and connections."""

from __future__ import annotations

from rce.client.declarations import Declarations
from rce.protocol.messages import (
    AddInterface,
    Command,
    Connect,
    CreateContainer,
    DestroyContainer,
    Disconnect,
    RemoveInterface,
)

STRING = "std_msgs/String"


def own(tag: str, robot: str = "a") -> AddInterface:
    return AddInterface(robot, tag, "SubscriberConverter", STRING)


def recorded(declarations: Declarations, *commands: Command) -> list[Command]:
    for command in commands:
        declarations.record(command)
    return [*declarations.commands()]


def test_only_own_interfaces_and_connections_are_recorded() -> None:
    commands = recorded(
        Declarations("a"),
        CreateContainer("brain"),
        AddInterface("brain", "scan", "PublisherInterface", STRING),
        own("out"),
        Connect("a/out", "brain/scan"),
        Connect("b/out", "brain/scan"),
    )
    assert commands == [own("out"), Connect("a/out", "brain/scan")]


def test_removals_are_forgotten_with_their_connections() -> None:
    declarations = Declarations("a")
    recorded(declarations, own("x"), own("y"), own("z"), Connect("a/x", "brain/i"), Connect("brain/j", "a/y"))
    assert recorded(declarations, RemoveInterface("a", "x")) == [own("y"), own("z"), Connect("brain/j", "a/y")]
    assert recorded(declarations, DestroyContainer("brain")) == [own("y"), own("z")]
    assert recorded(declarations, Connect("a/y", "a/z"), Disconnect("a/z", "a/y")) == [own("y"), own("z")]


def test_interfaces_of_a_guest_in_environments_are_recorded() -> None:
    interface = AddInterface("brain", "@desk.scan", "PublisherInterface", STRING)
    assert recorded(Declarations("@desk"), interface) == [interface]
    assert recorded(Declarations("a"), interface) == []
