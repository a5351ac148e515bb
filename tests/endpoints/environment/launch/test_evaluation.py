"""What a launch file describes, as the endpoint takes it over."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from endpoints.environment.launch import evaluation
from endpoints.environment.launch.evaluation import LaunchedNode, evaluate, launch_arguments, node_spec, tags
from endpoints.environment.output_log import OutputLog
from rce.control.calls.endpoints import NodeSpec
from rce.errors import InvalidRequest

NODE = "from launch_ros.actions import Node\nfrom launch import LaunchDescription\n"


async def evaluated(directory: Path, text: str, **arguments: str) -> list[LaunchedNode]:
    """Return the nodes of a launch file, whose log is `out.log` in the directory."""
    file = directory / "a.launch.py"
    file.write_text(text)
    spec, log = NodeSpec("launch", "demo", "", launch=file.name), OutputLog(directory / "out.log")
    return await evaluate(spec, file, arguments, {}, dict(os.environ), directory, directory, log)


async def test_launch_file_is_carried_out_in_a_process_of_its_own(tmp_path: Path) -> None:
    body = "print('hello'); return LaunchDescription([Node(package='demo', executable=str(os.getpid()))])"
    (node,) = await evaluated(tmp_path, f"import os\n{NODE}def generate_launch_description(): {body}\n")
    assert node.executable != str(os.getpid())
    assert (tmp_path / "out.log").read_text() == "hello\n"


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return LaunchDescription([Node(executable='e')])", "a.launch.py:4: Node: e has no package"),
        ("import os; os._exit(3)", "ended the interpreter with status 3"),
        ("return LaunchDescription([])", "describes no node with these arguments"),
    ],
)
async def test_wrong_launch_file_is_refused(tmp_path: Path, body: str, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        await evaluated(tmp_path, f"{NODE}\ndef generate_launch_description(): {body}\n")


async def test_argument_that_nobody_reads_is_refused(tmp_path: Path) -> None:
    body = "return LaunchDescription([Node(package='d', executable='e')])"
    with pytest.raises(InvalidRequest, match="no argument rate; it has no arguments"):
        await evaluated(tmp_path, f"{NODE}def generate_launch_description(): {body}\n", rate="5")


async def test_launch_file_that_does_not_end_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation, "TIMEOUT", 0.5)
    with pytest.raises(InvalidRequest, match=r"did not end within 0\.5 s"):
        await evaluated(tmp_path, "import time\ntime.sleep(60)\n")


def test_arguments_are_names_and_values() -> None:
    assert launch_arguments(["a:=1", "b:=", "c:=x:=y"]) == {"a": "1", "b": "", "c": "x:=y"}
    with pytest.raises(InvalidRequest, match="'rate=5' of the launch file: write NAME:=VALUE"):
        launch_arguments(["rate=5"])


def test_tags_are_names_within_the_launch() -> None:
    nodes = [LaunchedNode("p", "e.py"), LaunchedNode("p", "e.py"), LaunchedNode("p", "e", "cam-1", "/a/b")]
    assert tags(nodes, "up") == ["up.e", "up.e_2", "up.a.b.cam_1"]
    spec = node_spec(LaunchedNode("p", "e", "n", "/s", ["a b"]), "up.n")
    assert spec == NodeSpec("up.n", "p", "e", "'a b'", "n", "/s")


def test_parameters_become_files(tmp_path: Path) -> None:
    sets = [{"values": {"a.b": 1}}, {"file": "/f.yaml"}, {"text": "text"}]
    node = LaunchedNode("p", "e", arguments=["-x"], parameters=sets, remappings=[("a", "b")], ros_arguments=["--x"])
    assert node.command_arguments(tmp_path) == [
        *("-x", "--ros-args", "-r", "a:=b", "--params-file", str(tmp_path / "launch_0.yaml")),
        *("--params-file", "/f.yaml", "--params-file", str(tmp_path / "launch_2.yaml"), "--x", "--"),
    ]
    assert (tmp_path / "launch_0.yaml").read_text() == '/**:\n  ros__parameters:\n    "a.b": 1\n'
    assert (tmp_path / "launch_2.yaml").read_text() == "text"
    assert LaunchedNode("p", "e").command_arguments(tmp_path) == []
