"""A program continues with a context that has joined its domain before, as if it had made it itself."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from endpoints.environment.prepared_context import PROFILES
from endpoints.environment.prepared_node import ENCLAVE, NODE

START = """
import json, sys
from endpoints.environment.prepared_context import PreparedContext
from endpoints.environment.prepared_context import PROFILES
from endpoints.environment.prepared_node import become
context = PreparedContext()
joined = context._context
become(json.loads(sys.argv[1]), context)
"""
PROGRAM = """
import json, sys
import rclpy, rclpy.logging
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options
from rclpy.utilities import get_default_context
prepared = sys.modules["endpoints.environment.prepared_context"]
{init}
node = rclpy.create_node("own", **{options})
node.declare_parameter("answer", 0)
others = [name for name, _ in node.get_node_names_and_namespaces() if name != node.get_name()]
found = dict(
    name=node.get_fully_qualified_name(),
    topic=node.resolve_topic_name("say"),
    answer=node.get_parameter("answer").value,
    hidden=prepared.NODE in others,
    replaced=rclpy.init.__code__.co_filename == prepared.__file__,
    joined=type(started).__name__ == "_Given",
    enclave=node.get_node_names_and_namespaces_with_enclaves()[0][2],
    handles=get_current_signal_handlers_options().name,
    level=int(rclpy.logging.get_logger("own").get_effective_level()),
)
node.destroy_node()
rclpy.shutdown()
print(json.dumps(found))
"""


def run(
    directory: Path,
    *arguments: str,
    init: str = "started = rclpy.init()",
    options: str = "{}",
    changed: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return what a program finds that continues with a prepared context, started with these arguments."""
    program = directory / "node.py"
    program.write_text(PROGRAM.format(init=init, options=options))
    variables = {**os.environ, "ROS_DOMAIN_ID": "88"}
    order = {
        "command": [str(program), *arguments],
        "variables": {**variables, **(changed or {})},
        "directory": str(directory),
    }
    code = [sys.executable, "-c", START, json.dumps(order)]
    done = subprocess.run(code, check=False, capture_output=True, text=True, env=variables, timeout=50)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


OWN = ("--ros-args", "--disable-external-lib-logs", "--enclave", ENCLAVE)
REMAPPED = (*OWN, "-r", "__node:=other", "-r", "__ns:=/place", "-r", "say:=talk", "-p", "answer:=42")


def test_program_continues_with_the_context_and_its_node_gets_the_arguments(tmp_path: Path) -> None:
    found = run(tmp_path, *REMAPPED)
    assert found["joined"]
    assert (found["name"], found["topic"], found["answer"]) == ("/place/other", "/place/talk", 42)
    assert not found["hidden"], f"{NODE} ends when the program has a node"
    assert found["handles"] == "ALL", "rclpy.init installs handlers of signals"
    assert not found["replaced"], "a second rclpy.init is that of rclpy"


def test_arguments_of_a_node_come_before_those_of_the_program(tmp_path: Path) -> None:
    found = run(tmp_path, *REMAPPED, options="dict(cli_args=['--ros-args', '-r', 'say:=shout'])")
    assert (found["joined"], found["name"], found["topic"]) == (True, "/place/other", "/place/shout")


def test_node_may_ignore_the_arguments(tmp_path: Path) -> None:
    found = run(tmp_path, *REMAPPED, options="dict(use_global_arguments=False)")
    assert (found["joined"], found["name"], found["answer"]) == (True, "/own", 0)


def test_handlers_of_signals_are_not_installed_if_the_program_does_not_want_them(tmp_path: Path) -> None:
    init = "started = rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)"
    found = run(tmp_path, *OWN, init=init)
    assert (found["joined"], found["handles"]) == (True, "NO")


@pytest.mark.parametrize(
    "init", ["started = rclpy.init(args=[])", "started = rclpy.init(domain_id=89)"], ids=["arguments", "domain"]
)
def test_program_that_wants_another_context_gets_it(tmp_path: Path, init: str) -> None:
    found = run(tmp_path, *OWN, init=init)
    assert not found["joined"]
    assert found["name"] == "/own"


def test_enclave_of_a_program_takes_precedence(tmp_path: Path) -> None:
    found = run(tmp_path, *OWN[:-1], "/mine")
    assert (found["joined"], found["enclave"]) == (False, "/mine")


def test_options_of_the_process_have_their_effect(tmp_path: Path) -> None:
    found = run(tmp_path, *OWN, "--log-level", "debug", "-r", "__node:=other")
    assert (found["joined"], found["name"], found["level"]) == (False, "/other", 10)


@pytest.mark.parametrize("variable", ["ROS_DOMAIN_ID", "RMW_FASTRTPS_PUBLICATION_MODE", PROFILES])
def test_context_that_has_joined_otherwise_is_left(tmp_path: Path, variable: str) -> None:
    profile = tmp_path / "profile.xml"
    profile.write_text("<profiles/>")
    values = {"ROS_DOMAIN_ID": "89", "FASTDDS_DEFAULT_PROFILES_FILE": str(profile)}
    found = run(tmp_path, *REMAPPED, changed={variable: values.get(variable, "ASYNCHRONOUS")})
    assert (found["joined"], found["name"]) == (False, "/place/other")


def test_same_profile_in_another_file_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = tmp_path / "first.xml", tmp_path / "second.xml"
    for each in (first, second):
        each.write_text('<profiles xmlns="http://www.eprosima.com"/>')
    monkeypatch.setenv("FASTDDS_DEFAULT_PROFILES_FILE", str(first))
    assert run(tmp_path, *OWN, changed={"FASTDDS_DEFAULT_PROFILES_FILE": str(second)})["joined"]


def test_context_may_be_made_anew_later(tmp_path: Path) -> None:
    init = "rclpy.init(); rclpy.shutdown(); started = rclpy.init()"
    found = run(tmp_path, *REMAPPED, init=init)
    assert (found["joined"], found["name"], found["answer"]) == (False, "/place/other", 42)
