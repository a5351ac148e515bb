"""`robot`, `interface`, `connection`, `connect`, `disconnect`: robots, interfaces and their connections."""

from __future__ import annotations

import argparse
from typing import get_args

from rce.api import views
from rce.cli import output
from rce.cli.arguments import JSON, OF_USER, OF_USER_OR_ALL, argument
from rce.cli.command import Command
from rce.cli.session import ConsoleSession, user_query
from rce.protocol.messages import InterfaceType, Qos
from rce.protocol.names import split_interface

ROBOT = argument("robot", completion="robot", metavar="ROBOT", help="its robotID")
INTERFACE = argument(
    "interface", completion="interface", metavar="OWNER/INTERFACE", help="robotID or containerTag, and its tag"
)
ENDS = (
    argument("a", completion="interface", metavar="A/x", help="endpointTag/interfaceTag"),
    argument("b", completion="interface", metavar="B/y", help="the other interface; the order does not matter"),
)

ROBOTS: output.Columns[views.RobotView] = {
    "robot": lambda each: each.robotID,
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "endpoint": lambda each: each.endpoint,
    "interfaces": lambda each: each.interfaces,
}
INTERFACES: output.Columns[views.InterfaceView] = {
    "interface": lambda each: f"{each.endpointTag}/{each.interfaceTag}",
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "kind": lambda each: each.interfaceType,
    "type": lambda each: each.className,
    "address": lambda each: each.addr,
    "connections": lambda each: each.connections,
    "messages/s": lambda each: each.rate and each.rate.messages,
    "drops": lambda each: each.rate and each.rate.drops,
    "unheard": lambda each: each.rate and each.rate.unheard,
}
CONNECTIONS: output.Columns[views.ConnectionView] = {
    "from": lambda each: each.tagA,
    "to": lambda each: each.tagB,
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "type": lambda each: each.className,
    "messages/s": lambda each: each.rate and each.rate.messages,
    "drops": lambda each: each.rate and each.rate.drops,
}


def _robot_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(session.api.items(views.RobotView, "robots", user=user_query(args.of)), ROBOTS, args.json)


def _robot_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_record(session.api.get(views.RobotView, "robots", args.robot, user=args.of), args.json)


def _robot_disconnect(session: ConsoleSession, args: argparse.Namespace) -> None:
    for robot in args.robot:
        session.api.delete("robots", robot, user=args.of)


def _interface_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    query = {"user": user_query(args.of), "owner": args.owner, "type": args.type}
    output.print_table(session.api.items(views.InterfaceView, "interfaces", **query), INTERFACES, args.json)


def _interface_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    path = split_interface(args.interface, "interface")
    output.print_record(session.api.get(views.InterfaceView, "interfaces", *path, user=args.of), args.json)


def _interface_add(session: ConsoleSession, args: argparse.Namespace) -> None:
    owner, tag = split_interface(args.interface, "interface")
    qos = Qos(args.reliability, args.durability, depth=args.depth)
    body = views.NewInterface(owner, tag, args.kind, args.type, args.address, qos, args.format)
    session.api.post(views.InterfaceView, "interfaces", body=body, user=args.of)


def _interface_remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("interfaces", *split_interface(args.interface, "interface"), user=args.of)


def _connection_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(
        session.api.items(views.ConnectionView, "connections", user=user_query(args.of)), CONNECTIONS, args.json
    )


def _connect(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.post(views.ConnectionView, "connections", body=views.NewConnection(args.a, args.b), user=args.of)


def _disconnect(session: ConsoleSession, args: argparse.Namespace) -> None:
    ends = (*split_interface(args.a, "A/x"), *split_interface(args.b, "B/y"))
    session.api.delete("connections", *ends, user=args.of)


COMMANDS = (
    Command(
        "robot list",
        "List the robots that are connected.",
        _robot_list,
        (OF_USER_OR_ALL, JSON),
        ("robot list --of all",),
    ),
    Command("robot show", "Show a robot.", _robot_show, (ROBOT, OF_USER, JSON), ("robot show r2d2",)),
    Command(
        "robot disconnect",
        "End the sessions of robots, with their interfaces and connections.",
        _robot_disconnect,
        (argument("robot", completion="robot", metavar="ROBOT", nargs="+"), OF_USER),
        ("robot disconnect r2d2",),
    ),
    Command(
        "interface list",
        "List interfaces of robots and environments.",
        _interface_list,
        (
            argument(
                "owner",
                completion="endpoint",
                nargs="?",
                default="",
                metavar="OWNER",
                help="of one robot or environment",
            ),
            argument("--type", completion="type", default="", metavar="PKG/NAME", help="of one type"),
            OF_USER_OR_ALL,
            JSON,
        ),
        ("interface list brain", "interface list --type sensor_msgs/Image"),
    ),
    Command(
        "interface show",
        "Show an interface.",
        _interface_show,
        (INTERFACE, OF_USER, JSON),
        ("interface show brain/pose",),
    ),
    Command(
        "interface add",
        "Add an interface: …Interface to an environment, …Converter or …Forwarder to a robot.",
        _interface_add,
        (
            argument(
                "interface",
                completion="endpoint",
                metavar="OWNER/INTERFACE",
                help="robotID or containerTag, and a new tag",
            ),
            argument("kind", choices=get_args(InterfaceType), metavar="KIND", help="as PublisherInterface"),
            argument("type", completion="type", metavar="PKG/NAME"),
            argument("address", nargs="?", default="", metavar="ADDRESS", help="topic or service in the environment"),
            argument("--reliability", choices=("auto", "reliable", "best_effort"), default="auto"),
            argument("--durability", choices=("auto", "volatile", "transient_local"), default="auto"),
            argument("--depth", type=int, default=0, help="messages that wait (default: 1000; images, clouds: 10)"),
            argument("--format", default="png", help="png, jpeg, json (images), ros1 (Forwarders) or a converter"),
            OF_USER,
        ),
        ("interface add brain/pose PublisherInterface geometry_msgs/Pose2D /pose",),
    ),
    Command(
        "interface remove",
        "Remove an interface with its connections.",
        _interface_remove,
        (INTERFACE, OF_USER),
        ("interface remove brain/pose",),
    ),
    Command(
        "connection list", "List connections.", _connection_list, (OF_USER_OR_ALL, JSON), ("connection list --json",)
    ),
    Command("connect", "Connect two interfaces.", _connect, (*ENDS, OF_USER), ("connect r2d2/pose brain/pose",)),
    Command("disconnect", "Remove a connection.", _disconnect, (*ENDS, OF_USER), ("disconnect r2d2/pose brain/pose",)),
)
