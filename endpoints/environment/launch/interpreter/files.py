"""Launch files: Python, XML and YAML, and how one includes another."""

from __future__ import annotations

import importlib.util
import itertools
import traceback
from pathlib import Path
from typing import Any

from endpoints.environment.launch.interpreter.actions import Action
from endpoints.environment.launch.interpreter.context import Context, LaunchError
from endpoints.environment.launch.interpreter.substitutions import Text, perform

ENTRY = "generate_launch_description"
FORMS = (".py", ".xml", ".yaml", ".yml")
_numbers = itertools.count()


class LaunchDescriptionSource:
    """A launch file by its path. The last part of its name tells the form, whichever class names the file."""

    def __init__(self, launch_file_path: Text) -> None:
        self.launch_file_path = launch_file_path

    def visit(self, context: Context) -> None:
        """Carry the file out.

        Raises:
            LaunchError: It cannot be read or carried out.
        """
        path = Path(perform(context, self.launch_file_path))
        if not path.is_file():
            raise LaunchError(f"there is no launch file {path}")
        with context.within(path):
            read(path).visit(context)


class IncludeLaunchDescription(Action):
    """Carries out another launch file."""

    def __init__(self, launch_description_source: Any, *, launch_arguments: Any = None, **more: Any) -> None:
        super().__init__(**more)
        source = launch_description_source
        self.source = source if hasattr(source, "visit") else LaunchDescriptionSource(source)
        pairs = launch_arguments.items() if isinstance(launch_arguments, dict) else launch_arguments
        self.arguments = list(pairs or ())

    def execute(self, context: Context) -> None:
        """Carry it out with its arguments, which stay set after it as in ROS."""
        given = [(perform(context, name), perform(context, value)) for name, value in self.arguments]
        context.launch_configurations.update(given)
        self.source.visit(context)


def read(path: Path) -> Any:
    """Return the description in a launch file.

    Raises:
        LaunchError: It has an unknown form, or is wrong.
    """
    from endpoints.environment.launch.interpreter import markup

    match path.suffix:
        case ".py":
            return _read_python(path)
        case ".xml":
            root = markup.read_xml
        case ".yaml" | ".yml":
            root = markup.read_yaml
        case _:
            raise LaunchError(f"{path.name}: a launch file ends with one of {', '.join(FORMS)}")
    try:
        element = root(path.read_text())
    except LaunchError as error:
        raise LaunchError(f"{path.name}: {error}") from None
    return markup.description(element, path.name)


def _read_python(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(f"launch_file_{next(_numbers)}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        entry = getattr(module, ENTRY, None)
        if entry is None:
            raise LaunchError(f"{path.name} has no function {ENTRY}")
        return entry()
    except LaunchError:
        raise
    except Exception as error:
        raise LaunchError(f"{_place(error, path)}: {type(error).__name__}: {error}") from error


def _place(error: BaseException, path: Path) -> str:
    """Return the last line of a launch file that an error passed, as FILE:LINE."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    line = lines[-1] if lines else getattr(error, "lineno", None)
    return f"{path.name}:{line}" if line else path.name
