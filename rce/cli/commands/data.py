"""`topic`, `service` and `env shell`: data of environments, with the options of the command `ros2`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from rce.cli import output
from rce.cli.arguments import ENVIRONMENT, JSON, OF_USER, Argument, argument
from rce.cli.command import Command, Lazy
from rce.cli.session import ConsoleSession

if TYPE_CHECKING:
    from rce.control.calls.watching import RosName

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


def _ros_names(session: ConsoleSession, args: argparse.Namespace, kind: str) -> Iterator[RosName]:
    from rce.control.calls.watching import RosName

    return session.api.items(RosName, "environments", args.environment, kind, user=args.of)


def _topic_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(_ros_names(session, args, "topics"), TOPICS, args.json)


def _service_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(_ros_names(session, args, "services"), SERVICES, args.json)


class _AsGuest:
    """Function of a command that is a coroutine of `rce.cli.lazy` and works as a guest in an environment.

    `address` is the name of the argument that has the form ENV/NAME; the coroutine finds NAME as `topic`. If it is
    empty, the argument `environment` names the environment.
    """

    def __init__(self, work: Lazy, address: str = "topic") -> None:
        self.work = work
        self._address = address

    def __call__(self, session: ConsoleSession, args: argparse.Namespace) -> int:
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
        "topic list",
        "List the ROS topics of an environment.",
        _topic_list,
        (ENVIRONMENT, OF_USER, JSON),
        ("topic list brain",),
    ),
    Command(
        "topic echo",
        "Print the messages of a topic as YAML, until Ctrl-C.",
        _AsGuest(Lazy(TOPICS_MODULE, "echo")),
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
        _AsGuest(Lazy(TOPICS_MODULE, "hz")),
        RATE,
        ("topic hz brain/scan",),
    ),
    Command(
        "topic bw",
        "Print the bandwidth of a topic, as its messages arrive here.",
        _AsGuest(Lazy(TOPICS_MODULE, "bw")),
        RATE,
        ("topic bw brain/camera",),
    ),
    Command(
        "topic pub",
        "Publish on a topic, by default once a second until Ctrl-C.",
        _AsGuest(Lazy(TOPICS_MODULE, "pub")),
        (
            TOPIC,
            argument("type", completion="type", metavar="PKG/NAME"),
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
        "service list",
        "List the ROS services of an environment.",
        _service_list,
        (ENVIRONMENT, OF_USER, JSON),
        ("service list brain",),
    ),
    Command(
        "service call",
        "Call a service and print the response as YAML.",
        _AsGuest(Lazy(TOPICS_MODULE, "call"), "service"),
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
        "env shell",
        "Open a terminal in an environment; `~.` at the beginning of a line closes it.",
        _AsGuest(Lazy("rce.cli.lazy.env_shell", "shell"), ""),
        (
            OF_USER,
            ENVIRONMENT,
            argument("command", nargs="...", metavar="COMMAND", help="run this instead of an interactive shell"),
        ),
        ("env shell brain", "env shell brain ps aux", "env shell --of ann brain"),
    ),
)
