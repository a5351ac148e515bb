"""`robot`, `interface`, `connect`: robots and what is wired to what."""

from __future__ import annotations

import argparse
from typing import get_args

from rce import views
from rce.console import show
from rce.console.command import JSON, LISTED, OF, Command, argument
from rce.console.session import Session, whose
from rce.messages import InterfaceType, Qos
from rce.names import split_interface

ROBOT = argument("robot", live="robot", metavar="ROBOT", help="its robotID")
INTERFACE = argument("interface", live="interface", metavar="OWNER/INTERFACE", help="robotID or containerTag, and tag")
ENDS = (
    argument("a", live="interface", metavar="A/x", help="endpointTag/interfaceTag"),
    argument("b", live="interface", metavar="B/y", help="the other, in either order"),
)

ROBOTS: show.Columns[views.RobotView] = {
    "robot": lambda each: each.robotID,
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "endpoint": lambda each: each.endpoint,
    "interfaces": lambda each: each.interfaces,
}
INTERFACES: show.Columns[views.InterfaceView] = {
    "interface": lambda each: f"{each.endpointTag}/{each.interfaceTag}",
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "kind": lambda each: each.interfaceType,
    "type": lambda each: each.className,
    "address": lambda each: each.addr,
    "connections": lambda each: each.connections,
    "messages/s": lambda each: each.rate and each.rate.messages,
    "drops": lambda each: each.rate and each.rate.drops,
}
CONNECTIONS: show.Columns[views.ConnectionView] = {
    "from": lambda each: each.tagA,
    "to": lambda each: each.tagB,
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "type": lambda each: each.className,
    "messages/s": lambda each: each.rate and each.rate.messages,
    "drops": lambda each: each.rate and each.rate.drops,
}


def robot_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(session.api.items(views.RobotView, "robots", user=whose(words.of)), ROBOTS, words.json)


def robot_show(session: Session, words: argparse.Namespace) -> None:
    show.one(session.api.get(views.RobotView, "robots", words.robot, user=words.of), words.json)


def robot_disconnect(session: Session, words: argparse.Namespace) -> None:
    for robot in words.robot:
        session.api.delete("robots", robot, user=words.of)


def interface_list(session: Session, words: argparse.Namespace) -> None:
    query = {"user": whose(words.of), "owner": words.owner, "type": words.type}
    show.rows(session.api.items(views.InterfaceView, "interfaces", **query), INTERFACES, words.json)


def interface_show(session: Session, words: argparse.Namespace) -> None:
    path = split_interface(words.interface, "interface")
    show.one(session.api.get(views.InterfaceView, "interfaces", *path, user=words.of), words.json)


def interface_add(session: Session, words: argparse.Namespace) -> None:
    owner, tag = split_interface(words.interface, "interface")
    qos = Qos(words.reliability, words.durability, depth=words.depth)
    body = views.NewInterface(owner, tag, words.kind, words.type, words.address, qos, words.format)
    session.api.post(views.InterfaceView, "interfaces", body=body, user=words.of)


def interface_remove(session: Session, words: argparse.Namespace) -> None:
    session.api.delete("interfaces", *split_interface(words.interface, "interface"), user=words.of)


def connection_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(session.api.items(views.ConnectionView, "connections", user=whose(words.of)), CONNECTIONS, words.json)


def connect(session: Session, words: argparse.Namespace) -> None:
    session.api.post(views.ConnectionView, "connections", body=views.NewConnection(words.a, words.b), user=words.of)


def disconnect(session: Session, words: argparse.Namespace) -> None:
    ends = (*split_interface(words.a, "A/x"), *split_interface(words.b, "B/y"))
    session.api.delete("connections", *ends, user=words.of)


COMMANDS = (
    Command("robot list", "List the robots that are connected.", robot_list, (LISTED, JSON), ("robot list --of all",)),
    Command("robot show", "Show a robot.", robot_show, (ROBOT, OF, JSON), ("robot show r2d2",)),
    Command(
        "robot disconnect",
        "End the sessions of robots, with their interfaces and connections.",
        robot_disconnect,
        (argument("robot", live="robot", metavar="ROBOT", nargs="+"), OF),
        ("robot disconnect r2d2",),
    ),
    Command(
        "interface list",
        "List interfaces of robots and environments.",
        interface_list,
        (
            argument(
                "owner", live="endpoint", nargs="?", default="", metavar="OWNER", help="of one robot, environment"
            ),
            argument("--type", live="type", default="", metavar="PKG/NAME", help="of one type"),
            LISTED,
            JSON,
        ),
        ("interface list brain", "interface list --type sensor_msgs/Image"),
    ),
    Command(
        "interface show", "Show an interface.", interface_show, (INTERFACE, OF, JSON), ("interface show brain/pose",)
    ),
    Command(
        "interface add",
        "Add an interface: …Interface to an environment, …Converter or …Forwarder to a robot.",
        interface_add,
        (
            argument(
                "interface", live="endpoint", metavar="OWNER/INTERFACE", help="robotID or containerTag, a new tag"
            ),
            argument("kind", choices=get_args(InterfaceType), metavar="KIND", help="as PublisherInterface"),
            argument("type", live="type", metavar="PKG/NAME"),
            argument("address", nargs="?", default="", metavar="ADDRESS", help="topic or service in the environment"),
            argument("--reliability", choices=("auto", "reliable", "best_effort"), default="auto"),
            argument("--durability", choices=("auto", "volatile", "transient_local"), default="auto"),
            argument("--depth", type=int, default=10, help="messages that may wait (default: %(default)s)"),
            argument("--format", choices=("png", "jpeg", "json"), default="png", help="of images"),
            OF,
        ),
        ("interface add brain/pose PublisherInterface geometry_msgs/Pose2D /pose",),
    ),
    Command(
        "interface remove",
        "Remove an interface with its connections.",
        interface_remove,
        (INTERFACE, OF),
        ("interface remove brain/pose",),
    ),
    Command("connection list", "List connections.", connection_list, (LISTED, JSON), ("connection list --json",)),
    Command("connect", "Connect two interfaces.", connect, (*ENDS, OF), ("connect r2d2/pose brain/pose",)),
    Command("disconnect", "Take a connection away.", disconnect, (*ENDS, OF), ("disconnect r2d2/pose brain/pose",)),
)
