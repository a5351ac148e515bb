"""Launch files in XML and YAML."""

from __future__ import annotations

from pathlib import Path

import pytest

from endpoints.environment.launch.interpreter.context import LaunchError
from tests.support.endpoints.launch_files import carry_out, names

XML = """
    <launch>
      <arg name="x" default="3"/>
      <let name="y" value="$(var x)0"/>
      <set_env name="A" value="b"/>
      <set_parameter name="all" value="1.5"/>
      <group>
        <push-ros-namespace namespace="robot"/>
        <set_remap from="s" to="t"/>
        <node pkg="demo" exec="e" name="n$(var y)" args="-a '$(var x) b'" if="$(eval '$(var x) > 2')" respawn="true"
            respawn_delay="2.5" on_exit="shutdown" output="screen">
          <env name="C" value="d"/>
          <param name="p" value="$(var x)"/>
          <param name="l" value="1,2" value-sep=","/>
          <param name="t" value="5" type="str"/>
          <param name="g"><param name="h" value="true"/></param>
          <remap from="a" to="b"/>
        </node>
      </group>
      <timer period="1"><node pkg="demo" exec="late" unless="false"/></timer>
    </launch>
"""
YAML = """
    launch:
    - arg: {name: x, default: "3"}
    - let: {name: y, value: $(var x)0}
    - set_env: {name: A, value: b}
    - set_parameter: {name: all, value: 1.5}
    - group:
      - push_ros_namespace: {namespace: robot}
      - set_remap: {from: s, to: t}
      - node:
          pkg: demo
          exec: e
          name: n$(var y)
          args: -a '$(var x) b'
          if: $(eval '$(var x) > 2')
          respawn: true
          respawn_delay: 2.5
          on_exit: shutdown
          output: screen
          env:
          - {name: C, value: d}
          param:
          - {name: p, value: $(var x)}
          - {name: l, value: [1, 2]}
          - {name: t, value: "5", type: str}
          - name: g
            param:
            - {name: h, value: true}
          remap:
          - {from: a, to: b}
    - timer:
        period: 1
        children:
        - node: {pkg: demo, exec: late, unless: "false"}
"""


@pytest.mark.parametrize(("name", "text"), [("a.launch.xml", XML), ("a.launch.yaml", YAML)])
def test_both_forms_describe_the_same_nodes(tmp_path: Path, name: str, text: str) -> None:
    first, late = carry_out(tmp_path, name, text).nodes
    assert (first["name"], first["namespace"], first["arguments"]) == ("n30", "robot", ["-a", "3 b"])
    values = [each["values"] for each in first["parameters"]]
    assert values == [{"all": 1.5}, {"p": 3}, {"l": [1, 2]}, {"t": "5"}, {"g.h": True}]
    assert first["remappings"] == [("s", "t"), ("a", "b")]
    assert first["environment"] == {"A": "b", "C": "d"}
    assert (first["respawn"], first["respawn_delay"], first["required"]) == (True, 2.5, True)
    assert (late["executable"], late["delay"]) == ("late", 1.0)


def test_include_passes_arguments(tmp_path: Path) -> None:
    (tmp_path / "b.launch.yaml").write_text("launch:\n- arg: {name: z}\n- node: {pkg: demo, exec: e, name: $(var z)}\n")
    text = '<launch><include file="$(dirname)/b.launch.yaml"><arg name="z" value="zed"/></include></launch>'
    assert names(carry_out(tmp_path, "a.launch.xml", text)) == ["zed"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.launch.xml", "<launch>\n<executable cmd='ls'/></launch>", r"a.launch.xml:2: executable is not supported"),
        (
            "a.launch.xml",
            "<launch>\n<node pkg='demo'/></launch>",
            "a.launch.xml:2: node: the attribute exec is missing",
        ),
        ("a.launch.xml", "<launch><node pkg='d' exec='e' wrong='1'/></launch>", "node: wrong is not supported"),
        ("a.launch.xml", "<launch><node pkg='d' exec='e' if='1' unless='1'/></launch>", "both `if` and `unless`"),
        ("a.launch.xml", "<launch><group>\n<what/></group></launch>", "^a.launch.xml:2: what is not supported"),
        ("a.launch.xml", "<launch><arg name='a'/></launch>", "a.launch.xml:1: DeclareLaunchArgument: the argument a"),
        ("a.launch.xml", "<launch>", "a.launch.xml: no element found"),
        ("a.launch.xml", "<robot/>", "the root element is robot, not launch"),
        ("a.launch.xml", "<launch><node pkg='d' exec='e' on_exit='x'/></launch>", "on_exit may only be shutdown"),
        ("a.launch.xml", "<launch><node pkg='d' exec='e' respawn_delay='x'/></launch>", "'x' is not a number"),
        ("a.launch.yaml", "nodes: []", "single key `launch`"),
        ("a.launch.yaml", "launch: [word]", "line 1: an action is a mapping"),
        ("a.launch.yaml", "launch:\n- node: word", "line 2: node is neither a mapping nor a list"),
        ("a.launch.yaml", "launch: [", "a.launch.yaml: "),
    ],
)
def test_wrong_file_is_an_error_with_its_line(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(LaunchError, match=message):
        carry_out(tmp_path, name, text)
