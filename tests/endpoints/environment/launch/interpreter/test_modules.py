"""Modules that launch files import."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from endpoints.environment.launch.interpreter.context import Context, LaunchError
from tests.support.endpoints.launch_files import carry_out, modules

IMPORTS = """
from launch import LaunchDescription, LaunchContext
from launch.actions import IncludeLaunchDescription, ExecuteProcess, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.some_substitutions_type import SomeSubstitutionsType
from launch.substitutions import Command, LaunchConfiguration
from launch.utilities import perform_substitutions
from launch_ros.actions import ComposableNodeContainer, Node
from launch_ros.descriptions import ComposableNode, ParameterValue
from launch_ros.parameter_descriptions import ParameterFile
from launch_ros.substitutions import FindPackageShare
from launch_xml.launch_description_sources import XMLLaunchDescriptionSource
from ament_index_python.packages import get_package_share_directory, get_package_share_path
import launch, launch_ros.actions

def generate_launch_description():
    assert get_package_share_directory("demo") == str(get_package_share_path("demo")) == {share!r}
    assert launch.actions.IncludeLaunchDescription is IncludeLaunchDescription
    return LaunchDescription([{action}])
"""


def test_usual_imports_work(tmp_path: Path) -> None:
    text = IMPORTS.format(share=str(tmp_path), action="launch_ros.actions.Node(package='demo', executable='e')")
    assert len(carry_out(tmp_path, "a.launch.py", text, {"demo": str(tmp_path)}).nodes) == 1


@pytest.mark.parametrize(
    "action",
    ["ComposableNodeContainer(name='c')", "RegisterEventHandler(OnProcessExit())", "Command(['ls'])"],
)
def test_what_is_not_supported_is_refused_with_its_line(tmp_path: Path, action: str) -> None:
    text = IMPORTS.format(share=str(tmp_path), action=action)
    with pytest.raises(LaunchError, match=r"^a\.launch\.py:20: launch\S* is not supported: a launch file here"):
        carry_out(tmp_path, "a.launch.py", text, {"demo": str(tmp_path)})


def test_package_that_does_not_exist_is_not_found() -> None:
    with modules(Context({})):
        packages = importlib.import_module("ament_index_python.packages")
        with pytest.raises(packages.PackageNotFoundError, match="no package none"):
            packages.get_package_share_directory("none")
        with pytest.raises(LaunchError, match=r"launch\.actions\.Anything is not supported"):
            importlib.import_module("launch.actions").Anything()
