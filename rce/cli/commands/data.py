"""`topic`, `service`, `action` and `env shell`: data of environments, with the options of the command `ros2`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from rce.cli import output
from rce.cli.arguments import ENVIRONMENT, JSON, OF_USER, Argument, argument
from rce.cli.command import Command, Lazy
from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest
from rce.spelling import did_you_mean

if TYPE_CHECKING:
    from rce.control.calls.watching import RosAction, RosName

TOPICS_MODULE = "rce.cli.lazy.topics"

TOPIC = argument("topic", completion="topic", metavar="ENV/TOPIC", help="a topic of an environment, as brain/pose")
TYPE = argument("type", completion="type", nargs="?", default="", metavar="PKG/NAME", help="(default: the topic's)")
WINDOW = argument(
    "-w", "--window", type=int, default=10_000, metavar="N", help="average over N messages (default: %(default)s)"
)

TOPICS: output.Columns[RosName] = {
    "topic": lambda each: each.name,
    "type": lambda each: each.types,
    "publishers": lambda each: each.publishers,
    "subscribers": lambda each: each.subscribers,
}
SERVICES: output.Columns[RosName] = {"service": lambda each: each.name, "type": lambda each: each.types}
ACTIONS: output.Columns[RosAction] = {
    "action": lambda each: each.name,
    "type": lambda each: each.types,
    "servers": lambda each: len(each.servers),
    "clients": lambda each: len(each.clients),
}


def _ros_names(session: ConsoleSession, args: argparse.Namespace, kind: str) -> Iterator[RosName]:
    from rce.control.calls.watching import RosName

    return session.api.items(RosName, "environments", args.environment, kind, user=args.of)


def _actions(session: ConsoleSession, args: argparse.Namespace) -> Iterator[RosAction]:
    from rce.control.calls.watching import RosAction

    return session.api.items(RosAction, "environments", args.environment, "actions", user=args.of)


def _action_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(_actions(session, args), ACTIONS, args.json)


def _action_info(session: ConsoleSession, args: argparse.Namespace) -> None:
    from rce.cli.lazy.guest import split_address
    from rce.errors import NotFound

    args.environment, name = split_address(args.action)
    found = next((each for each in _actions(session, args) if each.name == name), None)
    if found is None:
        raise NotFound(f"there is no action {name} in {args.environment} at present; see `rce action list`")
    if args.json:
        output.print_record(found, as_json=True)
        return
    print(f"Action: {found.name}\nType: {', '.join(found.types)}")
    for title, nodes in (("Action servers", found.servers), ("Action clients", found.clients)):
        print("\n    ".join([f"{title}: {len(nodes)}", *nodes]))


def _topic_info(session: ConsoleSession, args: argparse.Namespace) -> None:
    from rce.cli.lazy.guest import split_address
    from rce.errors import NotFound

    args.environment, name = split_address(args.topic)
    topics = {each.name: each for each in _ros_names(session, args, "topics")}
    if name not in topics:
        hint = did_you_mean(name, topics) or "see `rce topic list`"
        raise NotFound(f"there is no topic {name} in {args.environment} at present: {hint}")
    found = topics[name]
    if args.json:
        output.print_record(found, as_json=True)
        return
    print(
        f"Type: {', '.join(found.types)}\nPublisher count: {found.publishers}\nSubscription count: {found.subscribers}"
    )


def _type_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    from rce.control.calls.robots import Definitions

    if "/" not in args.type:  # `ENV` was left out: `std_msgs/String` is read as an environment and its type
        given = f"{args.environment}/{args.type}"
        raise InvalidRequest(f"{args.type!r} is not a ROS type: write ENV PKG/NAME, as `rce type show brain {given}`")
    path = ("environments", args.environment, "types")
    found = session.api.get(Definitions, *path, type=args.type, sort=args.sort, user=args.of)
    if args.json:
        output.print_record(found, as_json=True)
        return
    first, *others = found.texts.items()
    print(first[1].rstrip())
    for name, text in others:
        print(f"\n{'=' * 80}\n{name}\n{text.rstrip()}")


def _topic_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(_ros_names(session, args, "topics"), TOPICS, args.json)


def list_ros_services(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print the ROS services of the environment `args.environment`."""
    output.print_table(_ros_names(session, args, "services"), SERVICES, args.json)


class AsGuest:
    """Function of a command that is a coroutine of `rce.cli.lazy` and works as a guest in an environment.

    `address` is the name of the argument that has the form ENV/NAME; the coroutine finds NAME as `topic`. If it is
    empty, the argument `environment` names the environment.
    """

    def __init__(self, work: Lazy, address: str = "topic") -> None:
        self.work = work
        self._address = address

    def __call__(self, session: ConsoleSession, args: argparse.Namespace) -> int:
        """Run the coroutine and return its exit status."""
        from rce.cli.lazy.guest import guest_in, run_until_signal, split_address

        if self._address:
            args.environment, args.topic = split_address(getattr(args, self._address))

        async def run() -> int:
            async with guest_in(session, args.environment, args.of) as guest:
                status: int = await self.work(guest, args)
                return status

        return run_until_signal(run)


RATE: tuple[Argument, ...] = (TOPIC, TYPE, WINDOW, OF_USER)
COMMANDS = (
    Command(
        "type show",
        "Print the definition of a ROS type that an environment knows, and of the types in it.",
        _type_show,
        (
            ENVIRONMENT,
            argument("type", completion="type", metavar="PKG/NAME"),
            argument("--sort", choices=("msg", "srv", "action"), default="msg", help="(default: %(default)s)"),
            OF_USER,
            JSON,
        ),
        ("type show brain geometry_msgs/Twist", "type show brain std_srvs/SetBool --sort srv"),
    ),
    Command(
        "topic info",
        "Print the type of a topic, and how many publish on it and subscribe to it.",
        _topic_info,
        (TOPIC, OF_USER, JSON),
        ("topic info brain/pose",),
    ),
    Command(
        "topic list",
        "List the ROS topics of an environment.",
        _topic_list,
        (ENVIRONMENT, OF_USER, JSON),
        ("topic list brain",),
    ),
    Command(
        "topic echo",
        "Print the messages of a topic as YAML, until Ctrl-C.",
        AsGuest(Lazy(TOPICS_MODULE, "echo")),
        (
            TOPIC,
            TYPE,
            argument("--once", action="store_true", help="print one message and end"),
            argument("--field", default="", metavar="A.B", help="print only this field of each message"),
            argument("--no-arr", action="store_true", help="print lengths instead of arrays"),
            argument("-f", "--full-length", action="store_true", help="do not cut long arrays and strings"),
            argument("--json", action="store_true", help="print each message as a line of JSON"),
            OF_USER,
        ),
        (
            "topic echo brain/pose",
            "topic echo brain/scan --once --no-arr",
            "topic echo --of ann brain/odom --field pose",
        ),
    ),
    Command(
        "topic hz",
        "Print the rate at which a topic's messages arrive here.",
        AsGuest(Lazy(TOPICS_MODULE, "hz")),
        RATE,
        ("topic hz brain/scan",),
    ),
    Command(
        "topic bw",
        "Print the bandwidth of a topic, as its messages arrive here.",
        AsGuest(Lazy(TOPICS_MODULE, "bw")),
        RATE,
        ("topic bw brain/camera",),
    ),
    Command(
        "topic pub",
        "Publish on a topic, by default once a second until Ctrl-C.",
        AsGuest(Lazy(TOPICS_MODULE, "pub")),
        (
            TOPIC,
            TYPE,
            argument(
                "values", nargs="?", default="{}", metavar="YAML", help="(default: the default values of all fields)"
            ),
            argument("-1", "--once", action="store_true", help="publish one message"),
            argument("-t", "--times", type=int, default=0, metavar="N", help="publish N messages"),
            argument(
                "-r", "--rate", type=float, default=1.0, metavar="HZ", help="messages per second (default: %(default)g)"
            ),
            OF_USER,
        ),
        (
            "topic pub --once brain/say std_msgs/String '{data: hello}'",
            "topic pub -r 10 brain/cmd_vel geometry_msgs/Twist",
        ),
    ),
    Command(
        "service call",
        "Call a service and print the response as YAML.",
        AsGuest(Lazy(TOPICS_MODULE, "call"), "service"),
        (
            argument("service", completion="service", metavar="ENV/SERVICE"),
            argument("type", metavar="PKG/NAME", nargs="?", default="", help="(default: the service's)"),
            argument("values", nargs="?", default="{}", metavar="YAML"),
            argument("--timeout", type=float, default=10.0, metavar="SECONDS", help="(default: %(default)g)"),
            argument("--json", action="store_true", help="print JSON"),
            OF_USER,
        ),
        ("service call brain/reset std_srvs/Empty", "service call brain/enable std_srvs/SetBool '{data: true}'"),
    ),
    Command(
        "action list",
        "List the ROS actions of an environment.",
        _action_list,
        (ENVIRONMENT, OF_USER, JSON),
        ("action list brain",),
    ),
    Command(
        "action info",
        "Print the type of an action, and the nodes that are its servers and clients.",
        _action_info,
        (argument("action", completion="action", metavar="ENV/ACTION"), OF_USER, JSON),
        ("action info brain/navigate_to_pose",),
    ),
    Command(
        "action send_goal",
        "Send a goal to an action server, and print its result as YAML; Ctrl-C cancels the goal.",
        AsGuest(Lazy(TOPICS_MODULE, "send_goal"), "action"),
        (
            argument("action", completion="action", metavar="ENV/ACTION"),
            argument("type", metavar="PKG/NAME", nargs="?", default="", help="(default: the action's)"),
            argument("values", nargs="?", default="{}", metavar="YAML"),
            argument("-f", "--feedback", action="store_true", help="print the feedback too"),
            argument(
                "--timeout", type=float, default=10.0, metavar="SECONDS", help="for acceptance (default: %(default)g)"
            ),
            argument("--json", action="store_true", help="print JSON"),
            OF_USER,
        ),
        ("action send_goal brain/fibonacci test_msgs/Fibonacci '{order: 5}' --feedback",),
    ),
    Command(
        "gateway",
        "Open local ports for clients of rosbridge and Foxglove in an environment, until Ctrl-C.",
        Lazy("rce.cli.lazy.gateway", "gateway"),
        (
            ENVIRONMENT,
            argument(
                "--rosbridge-port",
                type=int,
                default=9090,
                metavar="N",
                help="port on loopback; 0 for a free one (default: %(default)s)",
            ),
            argument("--foxglove-port", type=int, default=8765, metavar="N", help="the same (default: %(default)s)"),
            OF_USER,
        ),
        ("gateway brain",),
    ),
    Command(
        "env shell",
        "Open a terminal in an environment; `~.` at the beginning of a line closes it.",
        AsGuest(Lazy("rce.cli.lazy.env_shell", "shell"), ""),
        (
            OF_USER,
            ENVIRONMENT,
            argument("command", nargs="...", metavar="COMMAND", help="run this instead of an interactive shell"),
        ),
        ("env shell brain", "env shell brain ps aux", "env shell --of ann brain"),
    ),
)
