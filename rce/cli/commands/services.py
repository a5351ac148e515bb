"""`service`: services that users offer to others, their instances, and ROS services."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from rce.api import views
from rce.cli import output
from rce.cli.arguments import JSON, OF_USER, argument
from rce.cli.command import Command, Group, Lazy
from rce.cli.commands.data import list_ros_services
from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest
from rce.protocol.messages import Qos

GROUP = Group(
    "service",
    "Services that users publish for others' robots, and ROS services.",
    'A robot uses a published service by its name: robot.service("mapping2d").\n'
    "`service list ENV` and `service call` are for ROS services.",
)
SERVICE = argument("service", metavar="[USER/]NAME")
NAME = argument("service", metavar="NAME", help="of your own")

OFFERS: output.Columns[views.OfferView] = {
    "service": lambda each: reference(each),
    "takes": lambda each: sorted(each.service.takes),
    "gives": lambda each: sorted(each.service.gives),
    "calls": lambda each: sorted({*each.service.services, *each.service.actions}),
    "robots": lambda each: each.service.robots,
    "instances": lambda each: len(each.instances),
    "description": lambda each: each.service.description,
}
INSTANCES: output.Columns[views.InstanceView] = {
    "instance": lambda each: f"{each.user}/{each.containerTag}",
    "state": lambda each: each.state if each.current else f"{each.state}, outdated",
    "robots": lambda each: each.robots,
}


class Port(NamedTuple):
    """Topic, ROS service or action of a service, and what it is for robots."""

    kind: str
    name: str
    port: views.OfferedPort


PORTS: output.Columns[Port] = {
    "robots": lambda each: each.kind,
    "name": lambda each: each.name,
    "type": lambda each: each.port.type,
    "address": lambda each: each.port.address or each.name,
    "qos": lambda each: each.port.qos if each.port.qos != Qos() else "",
}


def _ports(service: views.NewOffer) -> list[Port]:
    kinds = {"send": service.takes, "receive": service.gives, "call": service.services, "send goals": service.actions}
    return [
        Port(kind, name, views.OfferedPort(port) if isinstance(port, str) else port)
        for kind, ports in kinds.items()
        for name, port in ports.items()
    ]


def reference(offer: views.OfferView) -> str:
    """Return the name by which others refer to an offer."""
    return f"{offer.user}/{offer.service.name}".removeprefix("@rce/")


def find(session: ConsoleSession, name: str, of: str = "") -> tuple[str, str]:
    """Return publisher and name of the service that `name` or `user/name` means to the user."""
    publisher, _, short = name.rpartition("/")
    if publisher:
        return publisher, short
    offers = {reference(each) for each in session.api.items(views.OfferView, "catalogue")}
    own = of or session.user
    return ("@rce" if name in offers and f"{own}/{name}" not in offers else own), name


def _list(session: ConsoleSession, args: argparse.Namespace) -> None:
    if args.environment:
        list_ros_services(session, args)
        return
    if args.of:
        raise InvalidRequest("--of needs ENV: it is for the ROS services of another user's environment")
    output.print_table(session.api.items(views.OfferView, "catalogue"), OFFERS, args.json)


def _show(session: ConsoleSession, args: argparse.Namespace) -> None:
    offer = session.api.get(views.OfferView, "catalogue", *find(session, args.service))
    if args.json:
        output.print_record(offer, as_json=True)
        return
    output.print_record(replace(offer.service, takes={}, gives={}, services={}, actions={}))
    if ports := _ports(offer.service):
        print()
        output.print_table(ports, PORTS)
    for user, uses in sorted(offer.uses.items()):
        print(f"used by {user}: {uses} times")
    if offer.instances:
        print()
        output.print_table(offer.instances, INSTANCES)


def _use(session: ConsoleSession, args: argparse.Namespace) -> None:
    publisher, name = find(session, args.service, args.of)
    body = views.NewUse(args.robot, args.tag)
    session.api.post(views.OfferView, "catalogue", publisher, name, "uses", body=body, user=args.of)
    tag = args.tag or name
    if args.robot:
        print(f"robot {args.robot} uses {args.service} as {tag}")
    else:
        print(f"environment {tag} runs {args.service}")


def _scale(session: ConsoleSession, args: argparse.Namespace) -> None:
    body = views.Scale(args.least, args.most)
    offer = session.api.patch(views.OfferView, "catalogue", session.user, args.service, body=body)
    print(f"{args.service}: {offer.service.least} to {offer.service.most} instances")


def _remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("catalogue", session.user, args.service)


TAG = argument("--as", dest="tag", default="", metavar="TAG", help="(default: the name of the service)")
COMMANDS = (
    Command(
        "service publish",
        "Publish the services of a service.yaml, with the packages beside it.",
        Lazy("rce.cli.lazy.publish", "publish"),
        (
            argument("path", type=Path, metavar="DIR|FILE", help="a service.yaml, or the package that has one"),
            argument(
                "--share", action="append", default=[], metavar="USER|all", help="(default: all, or as the file says)"
            ),
        ),
        ("service publish my_package", "service publish service.yaml --share ada"),
        description="Pushes DIR as `package push` does if it has a package.xml, and publishes the service that its "
        "service.yaml declares, with that version of the package. It replaces what you published under this name.",
    ),
    Command(
        "service list",
        "List the services that you may use, or with ENV the ROS services of an environment.",
        _list,
        (argument("environment", completion="environment", metavar="ENV", nargs="?", default=""), OF_USER, JSON),
        ("service list", "service list brain"),
    ),
    Command(
        "service show",
        "Print a service; to its publisher also its instances, their robots, and how often each user used it.",
        _show,
        (SERVICE, JSON),
        ("service show mapping2d", "service show ann/detector"),
    ),
    Command(
        "service use",
        "Let a connected robot use a service, or without --robot start an instance of your own.",
        _use,
        (SERVICE, argument("--robot", completion="robot", default="", metavar="ROBOT"), TAG, OF_USER),
        ("service use mapping2d", "service use ann/detector --robot r2d2"),
    ),
    Command(
        "service scale",
        "Set how many shared instances of a service run at least and at most.",
        _scale,
        (NAME, argument("least", type=int, metavar="LEAST"), argument("most", type=int, metavar="MOST")),
        ("service scale detector 1 4",),
    ),
    Command(
        "service remove",
        "Remove a service of your own, with its shared instances.",
        _remove,
        (NAME,),
        ("service remove detector",),
    ),
)
