"""`topic` and `service`, and `env shell`: the data of environments, as a robot sees it; options as those of `ros2`."""

from __future__ import annotations

import argparse
from collections.abc import Awaitable, Callable, Iterator
from typing import TYPE_CHECKING

from rce.console import show
from rce.console.command import ENVIRONMENT, JSON, OF, Argument, Command, argument
from rce.console.session import Session

if TYPE_CHECKING:  # most commands have no part in data
    from rce.calls.watching import RosName
    from rce.console.part import Part

TOPIC = argument("topic", live="topic", metavar="ENV/TOPIC", help="a topic of an environment, as brain/pose")
TYPE = argument("type", live="type", nargs="?", default="", metavar="PKG/NAME", help="(default: what the topic has)")
WINDOW = argument("-w", "--window", type=int, default=10_000, metavar="N", help="of N messages (default: %(default)s)")

TOPICS: show.Columns[RosName] = {
    "topic": lambda each: each.name,
    "type": lambda each: each.types,
    "publishers": lambda each: each.publishers,
    "subscribers": lambda each: each.subscribers,
}
SERVICES: show.Columns[RosName] = {"service": lambda each: each.name, "type": lambda each: each.types}


def names(session: Session, words: argparse.Namespace, kind: str) -> Iterator[RosName]:
    from rce.calls.watching import RosName

    return session.api.items(RosName, "environments", words.environment, kind, user=words.of)


def topic_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(names(session, words, "topics"), TOPICS, words.json)


def service_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(names(session, words, "services"), SERVICES, words.json)


def _attended(
    module: str, work: str, place: Callable[[argparse.Namespace], str]
) -> Callable[[Session, argparse.Namespace], int]:
    """A command that takes part in an environment: the function `work` of a module that is imported when it runs."""

    def run(session: Session, words: argparse.Namespace) -> int:
        from importlib import import_module

        from rce.console.part import attend, taking_part

        function: Callable[[Part, argparse.Namespace], Awaitable[int]] = getattr(import_module(module), work)
        environment = place(words)

        async def act() -> int:
            async with taking_part(session, environment, words.of) as part:
                return await function(part, words)

        return attend(act)

    return run


def _topic(words: argparse.Namespace) -> str:
    from rce.console.part import split

    words.environment, words.topic = split(words.topic)
    return str(words.environment)


def _on_topics(work: str) -> Callable[[Session, argparse.Namespace], int]:
    return _attended("rce.console.topics", work, _topic)


RATE: tuple[Argument, ...] = (TOPIC, TYPE, WINDOW, OF)
COMMANDS = (
    Command(
        "topic list",
        "List the ROS topics of an environment.",
        topic_list,
        (ENVIRONMENT, OF, JSON),
        ("topic list brain",),
    ),
    Command(
        "topic echo",
        "Print the messages of a topic as YAML, until Ctrl-C.",
        _on_topics("echo"),
        (
            TOPIC,
            TYPE,
            argument("--once", action="store_true", help="print one message and end"),
            argument("--field", default="", metavar="A.B", help="of each message that alone"),
            argument("--no-arr", action="store_true", help="arrays as their lengths only"),
            argument("-f", "--full-length", action="store_true", help="long arrays and strings too"),
            argument("--json", action="store_true", help="a line of JSON each"),
            OF,
        ),
        (
            "topic echo brain/pose",
            "topic echo brain/scan --once --no-arr",
            "topic echo --of ann brain/odom --field pose",
        ),
    ),
    Command(
        "topic hz", "Rate of a topic's messages, as they arrive here.", _on_topics("hz"), RATE, ("topic hz brain/scan",)
    ),
    Command("topic bw", "Bytes a second of a topic.", _on_topics("bw"), RATE, ("topic bw brain/camera",)),
    Command(
        "topic pub",
        "Publish on a topic, once a second until Ctrl-C unless told otherwise.",
        _on_topics("pub"),
        (
            TOPIC,
            argument("type", live="type", metavar="PKG/NAME"),
            argument("values", nargs="?", default="{}", metavar="YAML", help="(default: all fields as they begin)"),
            argument("-1", "--once", action="store_true", help="one message"),
            argument("-t", "--times", type=int, default=0, metavar="N", help="N messages"),
            argument("-r", "--rate", type=float, default=1.0, metavar="HZ", help="a second (default: %(default)g)"),
            OF,
        ),
        (
            "topic pub --once brain/say std_msgs/String '{data: hello}'",
            "topic pub -r 10 brain/cmd_vel geometry_msgs/Twist",
        ),
    ),
    Command(
        "service list",
        "List the ROS services of an environment.",
        service_list,
        (ENVIRONMENT, OF, JSON),
        ("service list brain",),
    ),
    Command(
        "service call",
        "Call a service and print its answer as YAML.",
        _attended("rce.console.topics", "call", lambda words: _topic_of_service(words)),
        (
            argument("service", live="service", metavar="ENV/SERVICE"),
            argument("type", metavar="PKG/NAME", nargs="?", default="", help="(default: what the service has)"),
            argument("values", nargs="?", default="{}", metavar="YAML"),
            argument("--timeout", type=float, default=10.0, metavar="SECONDS", help="(default: %(default)g)"),
            argument("--json", action="store_true", help="print JSON"),
            OF,
        ),
        ("service call brain/reset std_srvs/Empty", "service call brain/enable std_srvs/SetBool '{data: true}'"),
    ),
    Command(
        "env shell",
        "A terminal inside an environment; `~.` at the beginning of a line leaves it.",
        _attended("rce.console.terminal", "shell", lambda words: str(words.environment)),
        (OF, ENVIRONMENT, argument("command", nargs="...", metavar="COMMAND", help="instead of an interactive shell")),
        ("env shell brain", "env shell brain ps aux", "env shell --of ann brain"),
    ),
)


def _topic_of_service(words: argparse.Namespace) -> str:
    words.topic = words.service
    return _topic(words)
