"""Modules that launch files import: `launch`, `launch_ros` and `ament_index_python`.

A name that exists in ROS but is not supported can be imported; its use raises LaunchError with the line.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from endpoints.environment.launch.interpreter import actions, conditions, ros
from endpoints.environment.launch.interpreter import substitutions as s
from endpoints.environment.launch.interpreter.context import Context, LaunchError
from endpoints.environment.launch.interpreter.files import IncludeLaunchDescription, LaunchDescriptionSource

SUBSTITUTIONS = {
    name: value
    for name, value in vars(s).items()
    if isinstance(value, type) and issubclass(value, s.Substitution) and not name.startswith("FindPackage")
}
ACTIONS = {
    name: value
    for name, value in vars(actions).items()
    if isinstance(value, type) and issubclass(value, actions.Action) and value is not actions.LaunchDescription
} | {"IncludeLaunchDescription": IncludeLaunchDescription}
CONDITIONS = {name: value for name, value in vars(conditions).items() if name.startswith(("If", "Unless", "Launch"))}
ROS_ACTIONS = {
    "Node": ros.Node,
    "LifecycleNode": ros.Node,
    "PushRosNamespace": ros.PushRosNamespace,
    "PushROSNamespace": ros.PushRosNamespace,
    "SetParameter": ros.SetParameter,
    "SetParametersFromFile": ros.SetParametersFromFile,
    "SetRemap": ros.SetRemap,
    "SetUseSimTime": ros.SetUseSimTime,
}
ROS_SUBSTITUTIONS = {"FindPackageShare": s.FindPackageShare, "FindPackagePrefix": s.FindPackagePrefix}
PARAMETERS: dict[str, Any] = {"ParameterValue": ros.ParameterValue, "ParameterFile": ros.ParameterFile}
SOURCES = dict.fromkeys(
    ("PythonLaunchDescriptionSource", "AnyLaunchDescriptionSource", "FrontendLaunchDescriptionSource"),
    LaunchDescriptionSource,
)
TYPES: dict[str, Any] = {"SomeSubstitutionsType": object, "SomeEntitiesType": object}
CORE: dict[str, Any] = {
    "LaunchDescription": actions.LaunchDescription,
    "LaunchContext": Context,
    "Action": actions.Action,
    "Condition": conditions.Condition,
    "Substitution": s.Substitution,
    "LaunchDescriptionEntity": actions.Action,
    "LaunchDescriptionSource": LaunchDescriptionSource,
    **TYPES,
}


class Unsupported:
    """A name of ROS's launch that is not supported here; to use it is an error."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Raise LaunchError."""
        raise LaunchError(
            f"{actions.caller()}: {self._name} is not supported: a launch file here may only describe nodes"
        )


def install(context: Context) -> None:
    """Make the modules importable.

    Args:
        context: State of the launch, which knows the packages.
    """

    def share(name: str, print_warning: bool = True) -> str:
        if name not in context.packages:
            raise packages["PackageNotFoundError"](f"this environment has no package {name}")
        return context.packages[name]

    packages: dict[str, Any] = {
        "PackageNotFoundError": type("PackageNotFoundError", (KeyError,), {}),
        "get_package_share_directory": share,
        "get_package_share_path": lambda name, **_: Path(share(name)),
        "get_package_prefix": lambda name: str(s.prefix_of(Path(share(name)))),
    }
    contents: dict[str, dict[str, Any]] = {
        "launch": CORE,
        "launch.action": CORE,
        "launch.actions": ACTIONS,
        "launch.condition": CORE,
        "launch.conditions": CONDITIONS,
        "launch.event_handlers": {},
        "launch.events": {},
        "launch.launch_context": CORE,
        "launch.launch_description": CORE,
        "launch.launch_description_source": CORE,
        "launch.launch_description_sources": SOURCES,
        "launch.some_substitutions_type": TYPES,
        "launch.substitution": CORE,
        "launch.substitutions": SUBSTITUTIONS,
        "launch.utilities": {
            "perform_substitutions": s.perform,
            "normalize_to_list_of_substitutions": lambda text: text if isinstance(text, list | tuple) else [text],
        },
        "launch_ros": {},
        "launch_ros.actions": ROS_ACTIONS,
        "launch_ros.descriptions": PARAMETERS,
        "launch_ros.event_handlers": {},
        "launch_ros.events": {},
        "launch_ros.events.lifecycle": {},
        "launch_ros.parameter_descriptions": PARAMETERS,
        "launch_ros.substitutions": ROS_SUBSTITUTIONS,
        "launch_xml": {},
        "launch_xml.launch_description_sources": {"XMLLaunchDescriptionSource": LaunchDescriptionSource},
        "launch_yaml": {},
        "launch_yaml.launch_description_sources": {"YAMLLaunchDescriptionSource": LaunchDescriptionSource},
        "ament_index_python": packages,
        "ament_index_python.packages": packages,
    }
    for name, names in contents.items():
        sys.modules[name] = _module(name, names)
    for name in contents:
        outer, _, inner = name.rpartition(".")
        if outer:
            setattr(sys.modules[outer], inner, sys.modules[name])


def _module(name: str, names: dict[str, Any]) -> ModuleType:
    module = ModuleType(name)
    module.__path__ = []  # a package, so that a module within it that does not exist is named in the error
    vars(module).update(names)

    def missing(attribute: str) -> Any:
        if attribute.startswith("_"):
            raise AttributeError(f"module {name} has no attribute {attribute}")
        return Unsupported(f"{name}.{attribute}")

    vars(module)["__getattr__"] = missing
    return module
