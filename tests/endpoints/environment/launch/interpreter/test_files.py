"""Launch files of all forms, and how one includes another."""

from __future__ import annotations

from pathlib import Path

import pytest

from endpoints.environment.launch.interpreter.context import LaunchError
from tests.support.endpoints.launch_files import carry_out, names, python

INNER = """
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

def generate_launch_description():
    node = Node(package="demo", executable="e", name=LaunchConfiguration("x"))
    return LaunchDescription([DeclareLaunchArgument("x", default_value="default"), node])
"""


def test_file_includes_another_with_arguments(tmp_path: Path) -> None:
    (tmp_path / "inner.launch.py").write_text(INNER)
    source = f"'{tmp_path}/inner.launch.py'"
    assert names(python(tmp_path, f"IncludeLaunchDescription({source})")) == ["default"]
    given = f"IncludeLaunchDescription({source}, launch_arguments={{'x': 'given'}}.items())"
    assert names(python(tmp_path, given)) == ["given"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.launch.py", "x = 1", "a.launch.py has no function generate_launch_description"),
        ("a.launch.py", "x = 1\ny = 1 / 0", "a.launch.py:2: ZeroDivisionError: division by zero"),
        ("a.launch.py", "def generate_launch_description():\n    return no_name", "a.launch.py:2: NameError"),
        ("a.launch.py", "x = (", "a.launch.py:1: SyntaxError"),
        ("a.launch.py", "import launch.nothing", "a.launch.py:1: ModuleNotFoundError: .*launch.nothing"),
        ("a.launch.txt", "", "a launch file ends with one of .py, .xml, .yaml"),
    ],
)
def test_wrong_file_is_an_error(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(LaunchError, match=message):
        carry_out(tmp_path, name, text)


def test_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(LaunchError, match="there is no launch file /none"):
        python(tmp_path, "IncludeLaunchDescription('/none')")
