"""`env`, `node`, `param`: environments with their nodes and parameters."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator
from typing import Any

import msgspec

from rce.api import quantities, views
from rce.cli import output
from rce.cli.arguments import ENVIRONMENT, JSON, OF_USER, OF_USER_OR_ALL, argument
from rce.cli.command import Command
from rce.cli.session import ConsoleSession, user_query
from rce.errors import InvalidRequest, NotFound
from rce.protocol.messages import ContainerData
from rce.spelling import unknown

SIZE_OPTIONS = ("memory", "disk", "bandwidth")
FOLLOW = (
    argument("-f", "--follow", action="store_true", help="print new lines as they come, until Ctrl-C"),
    argument("-n", "--lines", type=int, default=100, metavar="N", help="print the last N lines (default: %(default)s)"),
)
NODE = argument("node", metavar="NODE", help="its nodeTag")
RESTART = argument(
    "--restart",
    choices=("on-failure", "always", "no"),
    default="",
    help="start it again when it ends, after growing pauses (default: after a failure, if it ran for 5 s)",
)

ENVIRONMENTS: output.Columns[views.EnvironmentView] = {
    "environment": lambda each: each.containerTag,
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "machine": lambda each: each.machine,
    "cores": lambda each: each.containerData.cpu or None,
    "memory": lambda each: output.size_text(each.containerData.memory or None),
    "nodes": lambda each: each.nodes,
    "interfaces": lambda each: each.interfaces,
    "group": lambda each: each.containerData.group,
    "image": lambda each: each.containerData.image,
}
NODES: output.Columns[views.NodeView] = {
    "node": lambda each: each.nodeTag,
    "state": lambda each: each.state,
    "program": lambda each: f"{each.pkg}/{each.launch or each.exe}",
    "arguments": lambda each: each.args,
    "name": lambda each: f"{each.namespace.rstrip('/')}/{each.name}".lstrip("/"),
    "restart": lambda each: each.restart,
    "last end": lambda each: each.end and _end_text(each.end),
}
PACKAGES: output.Columns[views.RosPackage] = {
    "package": lambda each: each.name,
    "executables": lambda each: each.executables,
}
PARAMETERS: output.Columns[views.ParameterView] = {
    "parameter": lambda each: each.name,
    "value": lambda each: yaml_text(each.value),
    "node": lambda each: each.nodeTag,
}


def _env_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    found = session.api.items(views.EnvironmentView, "environments", user=user_query(args.of))
    output.print_table(found, ENVIRONMENTS, args.json)


def _env_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_record(
        session.api.get(views.EnvironmentView, "environments", args.environment, user=args.of), args.json
    )


def _env_create(session: ConsoleSession, args: argparse.Namespace) -> None:
    body = views.NewEnvironment(args.environment, container_data(args))
    made = session.api.post(views.EnvironmentView, "environments", body=body, user=args.of)
    print(f"environment {made.containerTag} is {made.state} on {made.machine}")
    if ignored := [each for each in made.notEnforced if each != "egress"]:
        print(f"not enforced by this engine: {', '.join(ignored)}", file=sys.stderr)


def container_data(args: argparse.Namespace) -> ContainerData:
    """Return the containerData of the options of `env create`.

    Raises:
        InvalidRequest: A value is wrong; names the option.
    """
    names = {field.name for field in msgspec.structs.fields(ContainerData)}
    given = {name: value for name, value in vars(args).items() if name in names and value not in (None, [])}
    given |= {name: quantities.parse_size(given[name]) for name in SIZE_OPTIONS if name in given}
    given["env"] = dict(_parse_assignment(each) for each in args.env)
    given["secrets"] = {name: variable for name, _, variable in (each.partition("=") for each in args.secret)}
    try:
        return msgspec.convert(given, ContainerData)
    except msgspec.ValidationError as error:
        raise InvalidRequest(f"options of the environment: {error}") from None


def _parse_assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidRequest(f"--env {text!r}: write NAME=VALUE", field="env")
    return name, value


def _env_delete(session: ConsoleSession, args: argparse.Namespace) -> None:
    for environment in args.environment:
        session.api.delete("environments", environment, user=args.of)


def _env_logs(session: ConsoleSession, args: argparse.Namespace) -> None:
    _print_log(session, args, "environments", args.environment, "log", **({"verbose": True} if args.verbose else {}))


def _node_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    found = session.api.items(views.NodeView, "environments", args.environment, "nodes", user=args.of, all=args.all)
    output.print_table(found, NODES, args.json)


def _end_text(end: views.NodeEndView) -> str:
    """Return how and when a node ended, and the last line of its output."""
    how = end.signal or f"status {end.status}"
    times = f" ({end.count} times)" if end.count > 1 else ""
    last = f": {end.lines[-1]}" if end.lines else ""
    return f"{output.local_time(end.time)} {how}{times}{last}"


def _node_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    path = ("environments", args.environment, "nodes", args.node)
    output.print_record(session.api.get(views.NodeView, *path, user=args.of), args.json)


def _node_start(session: ConsoleSession, args: argparse.Namespace) -> None:
    body = views.NewNode(args.node, args.pkg, args.exe, args.args, args.name, args.namespace, restart=args.restart)
    session.api.post(views.NodeView, "environments", args.environment, "nodes", body=body, user=args.of)


def _node_launch(session: ConsoleSession, args: argparse.Namespace) -> None:
    given = shlex.join(args.arguments)
    body = views.NewNode(args.node, args.pkg, args=given, restart=args.restart, launch=args.launch)
    session.api.post(views.NodeView, "environments", args.environment, "nodes", body=body, user=args.of)


def _node_executables(session: ConsoleSession, args: argparse.Namespace) -> None:
    packages = list(session.api.items(views.RosPackage, "environments", args.environment, "packages", user=args.of))
    if args.package and args.package not in {each.name for each in packages}:
        raise NotFound(unknown("package", args.package, [each.name for each in packages]), field="package")
    output.print_table([each for each in packages if args.package in ("", each.name)], PACKAGES, args.json)


def _node_stop(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("environments", args.environment, "nodes", args.node, user=args.of)


def _node_logs(session: ConsoleSession, args: argparse.Namespace) -> None:
    _print_log(session, args, "environments", args.environment, "nodes", args.node, "log")


def _print_log(session: ConsoleSession, args: argparse.Namespace, *path: str, **more: object) -> None:
    query: dict[str, Any] = {"lines": args.lines, "user": args.of, **more}
    if not args.follow:
        _print_lines(session.api.get(views.LogLines, *path, **query))
        return
    for event in session.api.follow(*path, follow=True, **query):
        _print_lines(msgspec.json.decode(event.data, type=views.LogLines))


def _print_lines(log: views.LogLines) -> None:
    for line in log.lines:
        print(line, flush=True)


def _param_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(_parameters(session, args), PARAMETERS, args.json)


def _parameters(session: ConsoleSession, args: argparse.Namespace) -> Iterator[views.ParameterView]:
    path = ("environments", args.environment, "parameters")
    return session.api.items(views.ParameterView, *path, user=args.of, node=args.node)


def _param_get(session: ConsoleSession, args: argparse.Namespace) -> None:
    path = ("environments", args.environment, "parameters", args.name)
    found = session.api.get(views.ParameterView, *path, user=args.of, node=args.node)
    print(msgspec.json.encode(found).decode() if args.json else yaml_text(found.value))


def _param_set(session: ConsoleSession, args: argparse.Namespace) -> None:
    body = views.NewParameter(args.name, yaml_value(args.value), args.node)
    path = ("environments", args.environment, "parameters")
    session.api.post(views.ParameterView, *path, body=body, user=args.of)


def _param_delete(session: ConsoleSession, args: argparse.Namespace) -> None:
    path = ("environments", args.environment, "parameters", args.name)
    session.api.delete(*path, user=args.of, node=args.node)


def yaml_value(text: str) -> Any:
    """Parse a value as `ros2` does, as YAML.

    Raises:
        InvalidRequest: The text is not YAML.
    """
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InvalidRequest(f"{text!r} is not YAML: {error}", field="value") from None


def yaml_text(value: Any) -> str:
    """Return a value as one line of YAML."""
    import yaml

    return yaml.safe_dump(value, default_flow_style=True, width=10**9).removesuffix("...\n").strip()


OF_NODE = argument("--node", default="", metavar="NODE", help="of one node alone")

COMMANDS = (
    Command(
        "env list", "List environments.", _env_list, (OF_USER_OR_ALL, JSON), ("env list", "env list --of all --json")
    ),
    Command("env show", "Show an environment.", _env_show, (ENVIRONMENT, OF_USER, JSON), ("env show brain",)),
    Command(
        "env create",
        "Create an environment and wait until it is ready.",
        _env_create,
        (
            argument("environment", metavar="ENV", help="a new containerTag"),
            argument("--image", help="image to run (default: the machine's)"),
            argument("--size", type=int, metavar="SLOTS", help="slots that it occupies on its machine (default: 1)"),
            argument("--cpu", type=float, metavar="CORES"),
            argument("--memory", metavar="SIZE", help="as 2GiB"),
            argument("--pids", type=int, metavar="N", help="limit of processes and threads"),
            argument("--disk", metavar="SIZE"),
            argument("--bandwidth", metavar="SIZE", help="bytes per second"),
            argument("--gpus", type=int, metavar="N"),
            argument("--feature", dest="specialFeatures", action="append", default=[], metavar="NAME"),
            argument(
                "--env", action="append", default=[], metavar="NAME=VALUE", help="environment variable of its nodes"
            ),
            argument(
                "--secret",
                action="append",
                default=[],
                metavar="NAME[=VARIABLE]",
                help="secret of yours for its nodes: a file, and with VARIABLE a variable too",
            ),
            argument(
                "--package",
                dest="packages",
                action="append",
                default=[],
                metavar="NAME",
                help="package pushed with `rce package push`",
            ),
            argument("--group", completion="group", help="network group that it joins"),
            argument("--group-ip", dest="groupIP", metavar="ADDRESS", help="its address in the group"),
            argument("--restart", choices=("always", "no"), help="after it dies (default: always)"),
            OF_USER,
        ),
        ("env create brain", "env create brain --memory 2GiB --cpu 2 --group fleet --env LEVEL=debug"),
    ),
    Command(
        "env delete",
        "Delete environments and everything in them.",
        _env_delete,
        (argument("environment", completion="environment", metavar="ENV", nargs="+"), OF_USER),
        ("env delete brain",),
    ),
    Command(
        "env logs",
        "Print the output of an environment.",
        _env_logs,
        (
            ENVIRONMENT,
            *FOLLOW,
            argument("--verbose", action="store_true", help="with what is internal, as the Master's calls"),
            OF_USER,
        ),
        ("env logs brain -f", "env logs brain --verbose"),
    ),
    Command(
        "node list",
        "List the nodes of an environment, with how they ended the last time.",
        _node_list,
        (ENVIRONMENT, argument("--all", action="store_true", help="those too that have ended"), OF_USER, JSON),
        ("node list brain", "node list brain --all"),
    ),
    Command("node show", "Show a node.", _node_show, (ENVIRONMENT, NODE, OF_USER, JSON), ("node show brain mapper",)),
    Command(
        "node start",
        "Start a ROS 2 node.",
        _node_start,
        (
            ENVIRONMENT,
            argument("node", metavar="NODE", help="a new nodeTag"),
            argument("pkg", completion="package", metavar="PKG"),
            argument("exe", completion="executable", metavar="EXE"),
            argument("--args", default="", help="one word; $(find PKG) and $(env VAR) are replaced"),
            argument("--name", default="", help="ROS name"),
            argument("--namespace", default=""),
            RESTART,
            OF_USER,
        ),
        ("node start brain echo rce_demo echo", "node start brain rec demo rec.py --args='--rate 10' --namespace log"),
    ),
    Command(
        "node launch",
        "Start the nodes of a launch file.",
        _node_launch,
        (
            ENVIRONMENT,
            argument("node", metavar="TAG", help="a new nodeTag, with which the tags of its nodes begin: TAG.NAME"),
            argument("pkg", completion="package", metavar="PKG"),
            argument("launch", metavar="FILE", help="launch file of the package, in Python, XML or YAML"),
            argument("arguments", nargs="*", metavar="NAME:=VALUE", help="its arguments"),
            RESTART,
            OF_USER,
        ),
        ("node launch brain patrol demo patrol.launch.py rate:=5",),
    ),
    Command(
        "node executables",
        "List the ROS packages of an environment with their executables.",
        _node_executables,
        (
            ENVIRONMENT,
            argument("package", completion="package", metavar="PKG", nargs="?", default="", help="of this one only"),
            OF_USER,
            JSON,
        ),
        ("node executables brain", "node executables brain rce_demo"),
    ),
    Command(
        "node stop",
        "Stop a node, or a launch with its nodes.",
        _node_stop,
        (ENVIRONMENT, NODE, OF_USER),
        ("node stop brain mapper",),
    ),
    Command(
        "node logs",
        "Print the output of a node.",
        _node_logs,
        (ENVIRONMENT, NODE, *FOLLOW, OF_USER),
        ("node logs brain mapper -f",),
    ),
    Command(
        "param list",
        "List parameters.",
        _param_list,
        (ENVIRONMENT, OF_NODE, OF_USER, JSON),
        ("param list brain --json",),
    ),
    Command(
        "param get",
        "Print the value of a parameter.",
        _param_get,
        (ENVIRONMENT, argument("name", metavar="NAME"), OF_NODE, OF_USER, JSON),
        ("param get brain rate",),
    ),
    Command(
        "param set",
        "Set a parameter for nodes started later, and in running nodes that declare it.",
        _param_set,
        (ENVIRONMENT, argument("name", metavar="NAME"), argument("value", metavar="YAML"), OF_NODE, OF_USER),
        ("param set brain rate 10", "param set brain frames '[map, odom]' --node mapper"),
    ),
    Command(
        "param delete",
        "Delete a parameter.",
        _param_delete,
        (ENVIRONMENT, argument("name", metavar="NAME"), OF_NODE, OF_USER),
        ("param delete brain rate",),
    ),
)
