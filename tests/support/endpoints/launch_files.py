"""Launch files of tests, carried out by the interpreter in this process."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import dedent
from typing import Any

from endpoints.environment.launch.interpreter.context import Context
from endpoints.environment.launch.interpreter.files import LaunchDescriptionSource
from endpoints.environment.launch.interpreter.modules import install

IMPORTS = """from launch import LaunchDescription
from launch.actions import *
from launch.conditions import *
from launch.substitutions import *
from launch_ros.actions import *
from launch_ros.descriptions import *
from launch_ros.substitutions import *
"""


@contextmanager
def modules(context: Context) -> Iterator[None]:
    """Make the modules of launch files importable for a while."""
    before = dict(sys.modules)
    install(context)
    try:
        yield
    finally:
        for name in sys.modules.keys() - before.keys():
            del sys.modules[name]
        sys.modules.update(before)


def carry_out(directory: Path, name: str, text: str, packages: dict[str, str] | None = None, **arguments: str) -> Any:
    """Write a launch file, carry it out and return the context."""
    path = directory / name
    path.write_text(dedent(text))
    context = Context(packages, arguments)
    with modules(context):
        LaunchDescriptionSource(path).visit(context)
    return context


def python(directory: Path, actions: str, **arguments: str) -> Any:
    """Carry out a launch file in Python with these actions, and return the context."""
    text = f"{IMPORTS}def generate_launch_description():\n    return LaunchDescription([{actions}])\n"
    return carry_out(directory, "test.launch.py", text, {"demo": str(directory)}, **arguments)


def names(context: Any) -> list[str]:
    """Return the names of the nodes that were described."""
    return [node["name"] for node in context.nodes]
