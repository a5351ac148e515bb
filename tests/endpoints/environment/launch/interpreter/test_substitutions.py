"""Substitutions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from endpoints.environment.launch.interpreter import substitutions as s
from endpoints.environment.launch.interpreter.context import Context, LaunchError


@pytest.fixture
def context(tmp_path: Path) -> Context:
    context = Context({"demo": "/opt/share/demo", "source": "/src/source"}, {"rate": "5", "on": "True"})
    context.environment["COLOUR"] = "red"
    context.files = [tmp_path / "a.launch.py"]
    return context


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("plain", "plain"),
        (s.LaunchConfiguration("rate"), "5"),
        (s.LaunchConfiguration("none", default="9"), "9"),
        (["a", s.LaunchConfiguration("rate"), Path("/b")], "a5/b"),
        ("a/" + s.LaunchConfiguration("rate"), "a/5"),
        (s.LaunchConfiguration("rate") + "/b", "5/b"),
        (s.EnvironmentVariable("COLOUR"), "red"),
        (s.EnvironmentVariable("NONE", default_value="blue"), "blue"),
        (s.PathJoinSubstitution(["/a", s.LaunchConfiguration("rate"), "b"]), "/a/5/b"),
        (s.PythonExpression(["2 * ", s.LaunchConfiguration("rate"), " + floor(1.5)"]), "11"),
        (s.FindPackageShare("demo"), "/opt/share/demo"),
        (s.FindPackagePrefix("demo"), "/opt"),
        (s.FindPackagePrefix("source"), "/src/source"),
        (s.NotSubstitution(s.LaunchConfiguration("on")), "false"),
        (s.AndSubstitution("true", "0"), "false"),
        (s.OrSubstitution("true", "0"), "true"),
        (s.AllSubstitution("true", "1", "True"), "true"),
        (s.AllSubstitution("true", "0", "1"), "false"),
        (s.AnySubstitution("false", "0", "true"), "true"),
        (s.AnySubstitution("False", "0", "false"), "false"),
        (s.EqualsSubstitution(s.LaunchConfiguration("rate"), "5.0"), "true"),
        (s.EqualsSubstitution("a", "b"), "false"),
        (s.NotEqualsSubstitution("a", "b"), "true"),
        (s.IfElseSubstitution(s.LaunchConfiguration("on"), "a", "b"), "a"),
        (s.TextSubstitution(text="t"), "t"),
    ],
)
def test_substitution_has_value(context: Context, text: Any, value: str) -> None:
    assert s.perform(context, text) == value


def test_paths_of_launch_file_and_programs(context: Context, tmp_path: Path) -> None:
    assert s.perform(context, s.ThisLaunchFile()) == str(tmp_path / "a.launch.py")
    assert s.perform(context, s.ThisLaunchFileDir()) == str(tmp_path)
    assert s.perform(context, s.FindExecutable(name="sh")).endswith("/sh")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (s.LaunchConfiguration("none"), "no launch configuration none"),
        (s.EnvironmentVariable("NONE"), "no variable NONE"),
        (s.FindPackageShare("none"), "no package none"),
        (s.FindExecutable(name="no_such_program"), "no program no_such_program"),
        (s.PythonExpression("1 +"), "expression '1 \\+'"),
        (s.NotSubstitution("maybe"), "neither true nor false"),
        (5, "not a text"),
    ],
)
def test_substitution_without_value_is_an_error(context: Context, text: Any, message: str) -> None:
    with pytest.raises(LaunchError, match=message):
        s.perform(context, text)
