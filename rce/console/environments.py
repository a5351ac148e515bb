"""`env`, `node`, `param`: environments and what runs in them."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import msgspec

from rce import quantities, views
from rce.console import show
from rce.console.command import ENVIRONMENT, JSON, LISTED, OF, Command, argument
from rce.console.session import Session, whose
from rce.errors import InvalidRequest
from rce.messages import ContainerData

SIZES = ("memory", "disk", "bandwidth")
FOLLOW = (
    argument("-f", "--follow", action="store_true", help="go on with what comes, until Ctrl-C"),
    argument("-n", "--lines", type=int, default=100, metavar="N", help="the last N (default: %(default)s)"),
)
NODE = argument("node", metavar="NODE", help="its nodeTag")

ENVIRONMENTS: show.Columns[views.EnvironmentView] = {
    "environment": lambda each: each.containerTag,
    "user": lambda each: each.user,
    "state": lambda each: each.state,
    "machine": lambda each: each.machine,
    "cores": lambda each: each.containerData.cpu or None,
    "memory": lambda each: show.amount(each.containerData.memory),
    "nodes": lambda each: each.nodes,
    "interfaces": lambda each: each.interfaces,
    "group": lambda each: each.containerData.group,
    "image": lambda each: each.containerData.image,
}
NODES: show.Columns[views.NodeView] = {
    "node": lambda each: each.nodeTag,
    "state": lambda each: each.state,
    "program": lambda each: f"{each.pkg}/{each.exe}",
    "arguments": lambda each: each.args,
    "name": lambda each: f"{each.namespace.rstrip('/')}/{each.name}".lstrip("/"),
}
PARAMETERS: show.Columns[views.ParameterView] = {
    "parameter": lambda each: each.name,
    "value": lambda each: yaml_text(each.value),
    "node": lambda each: each.nodeTag,
}


def env_list(session: Session, words: argparse.Namespace) -> None:
    found = session.api.items(views.EnvironmentView, "environments", user=whose(words.of))
    show.rows(found, ENVIRONMENTS, words.json)


def env_show(session: Session, words: argparse.Namespace) -> None:
    show.one(session.api.get(views.EnvironmentView, "environments", words.environment, user=words.of), words.json)


def env_create(session: Session, words: argparse.Namespace) -> None:
    body = views.NewEnvironment(words.environment, container_data(words))
    made = session.api.post(views.EnvironmentView, "environments", body=body, user=words.of)
    print(f"environment {made.containerTag} is {made.state} on {made.machine}")


def container_data(words: argparse.Namespace) -> ContainerData:
    """What the options of `env create` say. InvalidRequest names the one at fault."""
    names = {field.name for field in msgspec.structs.fields(ContainerData)}
    given = {name: value for name, value in vars(words).items() if name in names and value not in (None, [])}
    given |= {name: quantities.size(given[name]) for name in SIZES if name in given}
    given["env"] = dict(_assignment(each) for each in words.env)
    try:
        return msgspec.convert(given, ContainerData)
    except msgspec.ValidationError as error:
        raise InvalidRequest(f"options of the environment: {error}") from None


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidRequest(f"--env {text!r}: write NAME=VALUE", field="env")
    return name, value


def env_delete(session: Session, words: argparse.Namespace) -> None:
    for environment in words.environment:
        session.api.delete("environments", environment, user=words.of)


def env_logs(session: Session, words: argparse.Namespace) -> None:
    _log(session, words, "environments", words.environment, "log")


def node_list(session: Session, words: argparse.Namespace) -> None:
    found = session.api.items(views.NodeView, "environments", words.environment, "nodes", user=words.of)
    show.rows(found, NODES, words.json)


def node_show(session: Session, words: argparse.Namespace) -> None:
    path = ("environments", words.environment, "nodes", words.node)
    show.one(session.api.get(views.NodeView, *path, user=words.of), words.json)


def node_start(session: Session, words: argparse.Namespace) -> None:
    body = views.NewNode(words.node, words.pkg, words.exe, words.args, words.name, words.namespace)
    session.api.post(views.NodeView, "environments", words.environment, "nodes", body=body, user=words.of)


def node_stop(session: Session, words: argparse.Namespace) -> None:
    session.api.delete("environments", words.environment, "nodes", words.node, user=words.of)


def node_logs(session: Session, words: argparse.Namespace) -> None:
    _log(session, words, "environments", words.environment, "nodes", words.node, "log")


def _log(session: Session, words: argparse.Namespace, *path: str) -> None:
    query: dict[str, Any] = {"lines": words.lines, "user": words.of}
    if not words.follow:
        _say(session.api.get(views.LogLines, *path, **query))
        return
    for event in session.api.follow(*path, follow=True, **query):
        _say(msgspec.json.decode(event.data, type=views.LogLines))


def _say(log: views.LogLines) -> None:
    for line in log.lines:
        print(line, flush=True)


def param_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(_parameters(session, words), PARAMETERS, words.json)


def _parameters(session: Session, words: argparse.Namespace) -> Iterator[views.ParameterView]:
    path = ("environments", words.environment, "parameters")
    return session.api.items(views.ParameterView, *path, user=words.of, node=words.node)


def param_get(session: Session, words: argparse.Namespace) -> None:
    path = ("environments", words.environment, "parameters", words.name)
    found = session.api.get(views.ParameterView, *path, user=words.of, node=words.node)
    print(msgspec.json.encode(found).decode() if words.json else yaml_text(found.value))


def param_set(session: Session, words: argparse.Namespace) -> None:
    body = views.NewParameter(words.name, yaml_value(words.value), words.node)
    path = ("environments", words.environment, "parameters")
    session.api.post(views.ParameterView, *path, body=body, user=words.of)


def param_delete(session: Session, words: argparse.Namespace) -> None:
    path = ("environments", words.environment, "parameters", words.name)
    session.api.delete(*path, user=words.of, node=words.node)


def yaml_value(text: str) -> Any:
    """A value as `ros2` takes it: YAML. InvalidRequest."""
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InvalidRequest(f"{text!r} is not YAML: {error}", field="value") from None


def yaml_text(value: Any) -> str:
    """A value in one line of YAML."""
    import yaml

    return yaml.safe_dump(value, default_flow_style=True, width=10**9).removesuffix("...\n").strip()


OF_NODE = argument("--node", default="", metavar="NODE", help="of one node alone")

COMMANDS = (
    Command("env list", "List environments.", env_list, (LISTED, JSON), ("env list", "env list --of all --json")),
    Command("env show", "Show an environment.", env_show, (ENVIRONMENT, OF, JSON), ("env show brain",)),
    Command(
        "env create",
        "Start an environment; ends when it is ready.",
        env_create,
        (
            argument("environment", metavar="ENV", help="a new containerTag"),
            argument("--image", help="what it runs (default: the machine's)"),
            argument("--size", type=int, metavar="SLOTS", help="slots of a machine (default: 1)"),
            argument("--cpu", type=float, metavar="CORES"),
            argument("--memory", metavar="SIZE", help="as 2GiB"),
            argument("--pids", type=int, metavar="N", help="processes and threads"),
            argument("--disk", metavar="SIZE"),
            argument("--bandwidth", metavar="SIZE", help="a second"),
            argument("--gpus", type=int, metavar="N"),
            argument("--feature", dest="specialFeatures", action="append", default=[], metavar="NAME"),
            argument("--env", action="append", default=[], metavar="NAME=VALUE", help="for its nodes"),
            argument("--package", dest="packages", action="append", default=[], metavar="NAME", help="that you pushed"),
            argument("--group", live="group", help="network group that it joins"),
            argument("--group-ip", dest="groupIP", metavar="ADDRESS", help="in the group"),
            argument("--restart", choices=("always", "no"), help="when it dies (default: always)"),
            OF,
        ),
        ("env create brain", "env create brain --memory 2GiB --cpu 2 --group fleet --env LEVEL=debug"),
    ),
    Command(
        "env delete",
        "Stop environments with all that is in them.",
        env_delete,
        (argument("environment", live="environment", metavar="ENV", nargs="+"), OF),
        ("env delete brain",),
    ),
    Command("env logs", "Output of an environment.", env_logs, (ENVIRONMENT, *FOLLOW, OF), ("env logs brain -f",)),
    Command("node list", "List the nodes of an environment.", node_list, (ENVIRONMENT, OF, JSON), ("node list brain",)),
    Command("node show", "Show a node.", node_show, (ENVIRONMENT, NODE, OF, JSON), ("node show brain mapper",)),
    Command(
        "node start",
        "Start a ROS 2 node.",
        node_start,
        (
            ENVIRONMENT,
            argument("node", metavar="NODE", help="a new nodeTag"),
            argument("pkg", metavar="PKG"),
            argument("exe", metavar="EXE"),
            argument("--args", default="", help="in one word; $(find PKG) and $(env VAR) are replaced"),
            argument("--name", default="", help="that ROS shows"),
            argument("--namespace", default=""),
            OF,
        ),
        ("node start brain echo rce_demo echo", "node start brain rec demo rec.py --args='--rate 10' --namespace log"),
    ),
    Command("node stop", "Stop a node.", node_stop, (ENVIRONMENT, NODE, OF), ("node stop brain mapper",)),
    Command(
        "node logs", "Output of a node.", node_logs, (ENVIRONMENT, NODE, *FOLLOW, OF), ("node logs brain mapper -f",)
    ),
    Command(
        "param list", "List parameters.", param_list, (ENVIRONMENT, OF_NODE, OF, JSON), ("param list brain --json",)
    ),
    Command(
        "param get",
        "Print the value of a parameter.",
        param_get,
        (ENVIRONMENT, argument("name", metavar="NAME"), OF_NODE, OF, JSON),
        ("param get brain rate",),
    ),
    Command(
        "param set",
        "Set a parameter, for nodes to come and live where a running node declares it.",
        param_set,
        (ENVIRONMENT, argument("name", metavar="NAME"), argument("value", metavar="YAML"), OF_NODE, OF),
        ("param set brain rate 10", "param set brain frames '[map, odom]' --node mapper"),
    ),
    Command(
        "param delete",
        "Forget a parameter.",
        param_delete,
        (ENVIRONMENT, argument("name", metavar="NAME"), OF_NODE, OF),
        ("param delete brain rate",),
    ),
)
