"""Nodes and their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from endpoints.environment.launch.interpreter.context import LaunchError
from endpoints.environment.launch.interpreter.ros import joined
from tests.support.endpoints.launch_files import python


def node(directory: Path, options: str, before: str = "", **arguments: str) -> dict[str, Any]:
    """Return the node that a launch file with these options describes."""
    text = f"{before}Node(package='demo', executable='e', output='screen', {options})"
    (found,) = python(directory, text, **arguments).nodes
    return dict(found)


@pytest.mark.parametrize(
    ("value", "found"),
    [
        ("5", 5),
        ("'5'", "5"),
        ("[1, 2]", [1, 2]),
        ("['a', 'b']", ["a", "b"]),
        ("LaunchConfiguration('x')", 7),
        ("[LaunchConfiguration('x'), '/b']", "7/b"),
        ("ParameterValue(LaunchConfiguration('x'), value_type=str)", "7"),
        ("ParameterValue(LaunchConfiguration('x'), value_type=float)", 7.0),
        ("LaunchConfiguration('none', default='')", ""),
    ],
)
def test_parameter_has_value(tmp_path: Path, value: str, found: object) -> None:
    (values,) = node(tmp_path, f"parameters=[{{'p': {value}}}]", x="7")["parameters"]
    assert values == {"values": {"p": found}}


def test_parameters_within_others_have_dotted_names(tmp_path: Path) -> None:
    (values,) = node(tmp_path, "parameters=[{'a': {'b': 1, 'c': {'d': 2}}}]")["parameters"]
    assert values == {"values": {"a.b": 1, "a.c.d": 2}}


def test_parameter_files_are_named_or_filled_in(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text("/**:\n  ros__parameters: {rate: $(var x)}\n")
    options = f"parameters=['{file}', ParameterFile('{file}', allow_substs=True)]"
    assert node(tmp_path, options, x="7")["parameters"] == [
        {"file": str(file)},
        {"text": "/**:\n  ros__parameters: {rate: 7}\n"},
    ]


def test_settings_of_group_come_before_those_of_node(tmp_path: Path) -> None:
    before = "PushRosNamespace('a'), SetParameter('p', 1), SetUseSimTime(True), SetRemap('x', 'y'),"
    found = node(tmp_path, "namespace='b', parameters=[{'q': 2}], remappings=[('v', 'w')]", before)
    assert found["namespace"] == "a/b"
    assert found["parameters"] == [{"values": {"p": 1}}, {"values": {"use_sim_time": True}}, {"values": {"q": 2}}]
    assert found["remappings"] == [("x", "y"), ("v", "w")]


def test_parameters_of_file_are_set_for_all(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("")
    found = node(tmp_path, "", f"SetParametersFromFile('{tmp_path}/p.yaml'),")
    assert found["parameters"] == [{"file": f"{tmp_path}/p.yaml"}]


def test_options_of_node(tmp_path: Path) -> None:
    options = "respawn=True, respawn_delay=2, on_exit=[Shutdown()], arguments=['-x', LaunchConfiguration('x')]"
    found = node(tmp_path, f"{options}, additional_env={{'A': 'b'}}", x="7")
    assert (found["respawn"], found["respawn_delay"], found["required"]) == (True, 2.0, True)
    assert found["arguments"] == ["-x", "7"]
    assert found["environment"] == {"A": "b"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("prefix='gdb'", "Node: prefix is not supported"),
        ("on_exit=[LogInfo(msg='x')]", "`on_exit` may only be Shutdown"),
        ("parameters=[{'p': None}]", "a parameter cannot be None"),
        ("parameters=['/none.yaml']", "no parameter file /none.yaml"),
        ("parameters=[{'p': ParameterValue('a', value_type=int)}]", "not of the type int"),
        ("parameters=[{'p': [LaunchConfiguration('x'), ': a: b']}]", "use ParameterValue"),
    ],
)
def test_wrong_option_is_an_error(tmp_path: Path, options: str, message: str) -> None:
    with pytest.raises(LaunchError, match=message):
        node(tmp_path, options, x="7")


def test_node_needs_a_package(tmp_path: Path) -> None:
    with pytest.raises(LaunchError, match="e has no package"):
        python(tmp_path, "Node(executable='e')")


@pytest.mark.parametrize(
    ("outer", "inner", "whole"), [("", "a", "a"), ("/a", "b", "/a/b"), ("a", "/b", "/b"), ("a", "", "a"), ("", "", "")]
)
def test_namespaces_are_joined(outer: str, inner: str, whole: str) -> None:
    assert joined(outer, inner) == whole
