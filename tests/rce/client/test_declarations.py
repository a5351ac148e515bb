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
        Connect("b/out", "brain/scan"),
    )
    assert commands == [own("out")]


def test_interfaces_of_environments_are_recorded_while_connected() -> None:
    declarations, scan = Declarations("a"), AddInterface("brain", "scan", "PublisherInterface", STRING)
    connect = Connect("a/out", "brain/scan")
    assert recorded(declarations, own("out"), scan, connect) == [own("out"), scan, connect]
    assert recorded(declarations, Disconnect("a/out", "brain/scan")) == [own("out")]
    assert recorded(declarations, connect) == [own("out"), scan, connect]
    assert recorded(declarations, RemoveInterface("brain", "scan")) == [own("out")]
    recorded(declarations, scan, connect)
    assert recorded(declarations, DestroyContainer("brain"), connect) == [own("out"), connect]


def test_interface_of_an_environment_that_exists_is_recorded() -> None:
    declarations, scan, connect = (
        Declarations("a"),
        AddInterface("brain", "scan", "PublisherInterface", STRING),
        Connect("a/out", "brain/scan"),
    )
    declarations.record_existing(scan)
    declarations.record_existing(AddInterface("a", "out", "PublisherConverter", STRING))
    declarations.record_existing(connect)
    assert recorded(declarations, own("out")) == [own("out")]
    assert recorded(declarations, connect) == [own("out"), scan, connect]


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
