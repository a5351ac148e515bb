"""Actions which do not concern ROS."""

from __future__ import annotations

from pathlib import Path

import pytest

from endpoints.environment.launch.interpreter.context import LaunchError
from tests.support.endpoints.launch_files import names, python

NODE = "Node(package='demo', executable='e', name=LaunchConfiguration('x'))"


def test_arguments_have_defaults_and_given_values(tmp_path: Path) -> None:
    declared = "DeclareLaunchArgument('x', default_value='plain', description='about x'),"
    assert names(python(tmp_path, declared + NODE)) == ["plain"]
    context = python(tmp_path, declared + NODE, x="given")
    assert names(context) == ["given"]
    assert context.declared == {"x": "about x"}


def test_settings_of_group_end_with_it(tmp_path: Path) -> None:
    group = f"GroupAction([SetLaunchConfiguration('x', 'in'), {NODE}]), "
    assert names(python(tmp_path, f"SetLaunchConfiguration('x', 'out'), {group}{NODE}")) == ["in", "out"]
    given = f"GroupAction([{NODE}], launch_configurations={{'x': 'given'}}, forwarding=False)"
    assert names(python(tmp_path, given)) == ["given"]


def test_configurations_are_saved_restored_and_removed(tmp_path: Path) -> None:
    changed = "PushLaunchConfigurations(), SetLaunchConfiguration('x', 'new'), PopLaunchConfigurations(),"
    assert names(python(tmp_path, changed + NODE, x="old")) == ["old"]
    with pytest.raises(LaunchError, match="no launch configuration x"):
        python(tmp_path, "UnsetLaunchConfiguration('x')," + NODE, x="old")


def test_action_whose_condition_does_not_hold_is_left_out(tmp_path: Path) -> None:
    node = "Node(package='demo', executable='e', name='{}', condition={})"
    both = ", ".join([node.format("a", "IfCondition('1')"), node.format("b", "UnlessCondition('1')")])
    assert names(python(tmp_path, both)) == ["a"]


def test_variables_are_set_extended_and_removed(tmp_path: Path) -> None:
    actions = (
        "SetEnvironmentVariable('V', 'b'), AppendEnvironmentVariable('V', 'c'),"
        "AppendEnvironmentVariable('V', 'a', prepend=True), UnsetEnvironmentVariable('PATH'),"
    )
    context = python(tmp_path, actions + NODE, x="n")
    assert context.nodes[0]["environment"] == {"V": "a:b:c", "PATH": None}


def test_timer_delays_nodes_also_within_another(tmp_path: Path) -> None:
    inner = f"TimerAction(period='0.5', actions=[{NODE}])"
    context = python(tmp_path, f"TimerAction(period=1.0, actions=[{inner}]), {NODE}", x="n")
    assert [node["delay"] for node in context.nodes] == [1.5, 0.0]


def test_function_returns_actions(tmp_path: Path) -> None:
    some = "[Node(package='demo', executable='e', name=context.launch_configurations['x'] + each) for each in args]"
    context = python(tmp_path, f"OpaqueFunction(function=lambda context, *args: {some}, args=['1', '2'])", x="n")
    assert names(context) == ["n1", "n2"]


def test_message_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    python(tmp_path, "LogInfo(msg=['rate ', LaunchConfiguration('x')])", x="5")
    assert capsys.readouterr().out == "rate 5\n"


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ("DeclareLaunchArgument('y')", "DeclareLaunchArgument: the argument y is missing: give it as y:=VALUE"),
        ("DeclareLaunchArgument('x', choices=['a', 'b'])", "the argument x is 'n', not one of a, b"),
        ("TimerAction(period='soon', actions=[])", "'soon' is not a number"),
        ("Shutdown()", "Shutdown: is supported as `on_exit`"),
        ("'word'", "'word' is not an action"),
        ("LogInfo(msg='a', loud=True)", "LogInfo: loud is not supported"),
    ],
)
def test_wrong_action_is_an_error_with_its_line(tmp_path: Path, actions: str, message: str) -> None:
    with pytest.raises(LaunchError, match=r"^test\.launch\.py:9: ") as raised:
        python(tmp_path, actions, x="n")
    assert message in str(raised.value)
