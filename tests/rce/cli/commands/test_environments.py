"""`env`, `node`, `param`."""

from __future__ import annotations

import json
import re
import shlex

import pytest

from rce.api.views import LogLines, NodeEndView, ParameterView, RosPackage
from rce.cli.commands.environments import yaml_text, yaml_value
from rce.cli.execute import FAILURE, SUCCESS
from rce.protocol.messages import ContainerData
from tests.support.console import Console, Request, environment, login, node, rce
from tests.support.master.served import Served


async def test_json_output_is_the_response_of_the_api(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served.url, "ann", "home")
    await rce("env", "create", "brain", "--memory", "1.5GiB", "--env", "A=b=c")
    await rce("param", "set", "brain", "frames", "[map, odom]")
    capsys.readouterr()
    await rce("env", "show", "brain", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed == (await served.ask("GET", "/environments/brain")).body
    assert (printed["containerData"]["memory"], printed["containerData"]["env"]) == (3 * 2**29, {"A": "b=c"})
    await rce("param", "get", "brain", "frames")
    assert capsys.readouterr().out == "[map, odom]\n"


CREATED = environment()


def test_environment_is_created_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    options = "--memory 1.5GiB --cpu 2 --group fleet --group-ip 10.0.0.2 --env A=b=c --package nav --of eve"
    data = {
        "memory": 3 * 2**29,
        "cpu": 2.0,
        "group": "fleet",
        "groupIP": "10.0.0.2",
        "env": {"A": "b=c"},
        "packages": ["nav"],
    }
    body = {"containerTag": "brain", "containerData": data}
    made = Console(CREATED).request(f"env create brain {options}")
    assert made == Request("POST environments", {"user": "eve"}, body)
    assert capsys.readouterr().out == "environment brain is ready on machine-1\n"


def test_options_without_effect_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    Console(environment(notEnforced=["disk", "egress", "io"])).request("env create brain --disk 1GiB")
    assert capsys.readouterr().err == "not enforced by this engine: disk, io\n"


def test_environment_without_options_gets_the_defaults() -> None:
    assert Console(CREATED).request("env create brain").body == {"containerTag": "brain", "containerData": {}}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ("--memory lots", "'lots' is not a size"),
        ("--env A", "--env 'A': write NAME=VALUE"),
        ("--size 0", "options of the environment: .*size"),
    ],
)
def test_wrong_option_is_refused_before_anything_is_sent(
    options: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    console = Console()
    assert console.run(f"env create brain {options}") == FAILURE
    assert re.search(reason, capsys.readouterr().err)
    assert not console.api.requests


def test_each_named_environment_is_deleted() -> None:
    console = Console()
    assert console.run("env delete a b --of eve") == SUCCESS
    assert console.api.requests == [Request(f"DELETE environments/{tag}", {"user": "eve"}) for tag in ("a", "b")]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("env list", Request("GET environments", {})),
        ("env list --of all", Request("GET environments", {"user": "*"})),
        ("env list --of eve", Request("GET environments", {"user": "eve"})),
        ("node list brain", Request("GET environments/brain/nodes", {"all": False})),
        ("node list brain --all", Request("GET environments/brain/nodes", {"all": True})),
        ("param list brain --node echo", Request("GET environments/brain/parameters", {"node": "echo"})),
    ],
)
def test_list_is_requested(line: str, expected: Request) -> None:
    assert Console([]).request(line) == expected


def test_environments_are_listed_with_what_they_got(capsys: pytest.CaptureFixture[str]) -> None:
    Console([environment(), environment("waits", state="waiting", machine="", containerData=ContainerData())]).request(
        "env list"
    )
    _, first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["brain", "ann", "ready", "machine-1", "2", "1.5", "GiB", "3", "5", "-", "-"]
    assert second.split() == ["waits", "ann", "waiting", "-", "-", "-", "3", "5", "-", "-"]


@pytest.mark.parametrize(
    ("namespace", "name", "shown"),
    [("", "", "-"), ("", "echo", "echo"), ("/", "echo", "echo"), ("/r2/", "echo", "r2/echo"), ("r2", "", "r2/")],
)
def test_node_is_listed_with_its_ros_name(
    namespace: str, name: str, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Console([node(namespace=namespace, name=name)]).request("node list brain")
    assert capsys.readouterr().out.splitlines()[1].split() == ["echo", "running", "rce_demo/echo", "-", shown, "-", "-"]


def test_ended_node_is_listed_with_signal_and_last_line(capsys: pytest.CaptureFixture[str]) -> None:
    end = NodeEndView(1e9, -9, "SIGKILL", 3, ["one", "last words"])
    Console([node(state="ended", end=end)]).request("node list brain --all")
    assert "SIGKILL (3 times): last words" in capsys.readouterr().out


def test_node_is_shown_without_its_empty_fields(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console(node()).request("node show brain echo") == Request("GET environments/brain/nodes/echo", {})
    assert [line.split() for line in capsys.readouterr().out.splitlines()][-2:] == [
        ["pkg", "rce_demo"],
        ["exe", "echo"],
    ]


def test_node_is_started_with_its_arguments() -> None:
    made = Console(node()).request(
        "node start brain rec demo rec.py --args='--rate 10' --namespace log --name r --restart on-failure"
    )
    fields = {"nodeTag": "rec", "pkg": "demo", "exe": "rec.py", "args": "--rate 10", "name": "r", "namespace": "log"}
    more = {"existOk": False, "restart": "on-failure", "launch": ""}
    assert made == Request("POST environments/brain/nodes", {}, fields | more)


def test_launch_file_is_started_with_its_arguments() -> None:
    made = Console(node()).request("node launch brain up demo up.launch.py rate:=5 'text:=a b'")
    fields = {"nodeTag": "up", "pkg": "demo", "exe": "", "args": "rate:=5 'text:=a b'", "name": "", "namespace": ""}
    more = {"existOk": False, "restart": "", "launch": "up.launch.py"}
    assert made == Request("POST environments/brain/nodes", {}, fields | more)


PACKAGES = [RosPackage("demo", ["listen", "talk"]), RosPackage("nav", ["plan"])]


def test_executables_are_listed_by_package(capsys: pytest.CaptureFixture[str]) -> None:
    made = Console(PACKAGES).request("node executables brain --of eve")
    assert made == Request("GET environments/brain/packages", {"user": "eve"})
    assert [line.split() for line in capsys.readouterr().out.splitlines()[1:]] == [
        ["demo", "listen,", "talk"],
        ["nav", "plan"],
    ]
    Console(PACKAGES).request("node executables brain nav --json")
    assert json.loads(capsys.readouterr().out) == [{"name": "nav", "executables": ["plan"]}]


def test_misspelt_package_is_answered_with_the_nearest_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console(PACKAGES).run("node executables brain dmo") == FAILURE
    assert "there is no package 'dmo': did you mean demo?" in capsys.readouterr().err


def test_node_is_stopped() -> None:
    assert Console().request("node stop brain echo") == Request("DELETE environments/brain/nodes/echo", {})


@pytest.mark.parametrize(
    ("line", "path"), [("env logs brain", "environments/brain/log"), ("node logs b n", "environments/b/nodes/n/log")]
)
def test_last_lines_of_a_log_are_printed(line: str, path: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert Console(LogLines(["one", "two"])).request(f"{line} -n 2") == Request(f"GET {path}", {"lines": 2})
    assert capsys.readouterr().out == "one\ntwo\n"


def test_whole_log_of_an_environment_is_requested() -> None:
    asked = Console(LogLines([], "")).request("env logs brain --verbose -n 2")
    assert asked.query == {"lines": 2, "verbose": True}


def test_log_is_followed(capsys: pytest.CaptureFixture[str]) -> None:
    made = Console([LogLines(["one"]), LogLines(["two", "three"])]).request("env logs brain -f")
    assert made == Request("FOLLOW environments/brain/log", {"follow": True, "lines": 100})
    assert capsys.readouterr().out == "one\ntwo\nthree\n"


@pytest.mark.parametrize(
    ("text", "value"),
    [("10", 10), ("1.5", 1.5), ("true", True), ("'10'", "10"), ("hello", "hello"), ("[map, odom]", ["map", "odom"])],
)
def test_value_of_a_parameter_is_yaml(text: str, value: object) -> None:
    body = {"name": "rate", "value": value, "nodeTag": "echo"}
    made = Console().request(shlex.join(["param", "set", "brain", "rate", text, "--node", "echo"]))
    assert made == Request("POST environments/brain/parameters", {}, body)
    assert yaml_value(yaml_text(value)) == value


def test_value_that_is_not_yaml_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console().run("param set brain rate '[1'") == FAILURE
    assert "'[1' is not YAML" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "text"), [(5, "5"), ("5", "'5'"), ([1, "a"], "[1, a]"), ("x" * 200, "x" * 200), (None, "null")]
)
def test_value_is_printed_as_one_line_of_yaml(value: object, text: str) -> None:
    assert yaml_text(value) == text


def test_parameter_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    found = ParameterView("ann", "brain", "", "frames", ["map", "odom"])
    assert Console(found).request("param get brain frames") == Request("GET environments/brain/parameters/frames", {})
    Console(found).request("param get brain frames --json")
    plain, as_json = capsys.readouterr().out.splitlines()
    assert plain == "[map, odom]"
    assert json.loads(as_json)["value"] == ["map", "odom"]


def test_parameter_of_a_node_is_deleted() -> None:
    made = Console().request("param delete brain rate --node echo")
    assert made == Request("DELETE environments/brain/parameters/rate", {"node": "echo"})
