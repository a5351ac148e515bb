"""Actions, parameters and substitutions of launch files which concern ROS."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from endpoints.environment.launch.interpreter.actions import Action, Shutdown
from endpoints.environment.launch.interpreter.context import Context, LaunchError
from endpoints.environment.launch.interpreter.grammar import parse
from endpoints.environment.launch.interpreter.substitutions import Substitution, Text, perform

IGNORED = {"output", "emulate_tty", "log_cmd", "sigterm_timeout", "sigkill_timeout", "ros_arguments_first", "autostart"}
"""Options of nodes without a meaning here: all output is kept in a log, and ends have the platform's pauses."""


class ParameterValue:
    """Value of a parameter with its type."""

    def __init__(self, value: Any, *, value_type: Any = None) -> None:
        self.value, self.value_type = value, value_type

    def evaluate(self, context: Context) -> Any:
        """Return the value; raise LaunchError if it is not of the type."""
        if self.value_type is None:
            return parameter_value(context, self.value)
        if self.value_type is str:
            return perform(context, self.value) if _is_text(self.value) else str(self.value)
        value = parameter_value(context, self.value)
        if self.value_type is float and type(value) is int:
            return float(value)
        if isinstance(self.value_type, type) and type(value) is not self.value_type:
            raise LaunchError(f"the value {value!r} is not of the type {self.value_type.__name__}")
        return value


class ParameterFile:
    """File of parameters; with `allow_substs` it may have substitutions as in XML."""

    def __init__(self, param_file: Text, *, allow_substs: bool | Text = False) -> None:
        self.param_file, self.allow_substs = param_file, allow_substs

    def evaluate(self, context: Context) -> dict[str, Any]:
        """Return the set of parameters; raise LaunchError if the file cannot be read."""
        path = Path(perform(context, self.param_file))
        if not path.is_file():
            raise LaunchError(f"there is no parameter file {path}")
        allowed = self.allow_substs
        if not isinstance(allowed, bool):
            allowed = perform(context, allowed).lower() == "true"
        return {"text": perform(context, parse(path.read_text()))} if allowed else {"file": str(path)}


def parameter_value(context: Context, value: Any) -> Any:
    """Return the value of a parameter. What substitutions yield is read as YAML, so that `5` is a number.

    Raises:
        LaunchError: ROS has no such type.
    """
    if isinstance(value, ParameterValue):
        return value.evaluate(context)
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Path):
        return str(value)
    items = list(value) if isinstance(value, Iterable) else []
    if hasattr(value, "perform") or any(hasattr(item, "perform") for item in items):
        text = perform(context, value)
        try:
            return yaml.safe_load(text) if text else ""
        except yaml.YAMLError as error:
            raise LaunchError(
                f"the value {text[:80]!r} is not YAML; use ParameterValue(…, value_type=str): {error}"
            ) from None
    if isinstance(value, list | tuple):
        return [parameter_value(context, item) for item in items]
    raise LaunchError(f"a parameter cannot be {value!r}")


def parameter_set(context: Context, parameters: Any) -> dict[str, Any]:
    """Return parameters of a node: `{"values": …}`, `{"file": path}` or `{"text": content of a file}`."""
    if isinstance(parameters, ParameterFile):
        return parameters.evaluate(context)
    if isinstance(parameters, dict):
        return {"values": dict(_flat(context, parameters, ""))}
    return ParameterFile(parameters).evaluate(context)


def _flat(context: Context, parameters: dict[Any, Any], prefix: str) -> Iterable[tuple[str, Any]]:
    for key, value in parameters.items():
        name = prefix + perform(context, key)
        if isinstance(value, dict):
            yield from _flat(context, value, f"{name}.")
        else:
            yield name, parameter_value(context, value)


class Node(Action):
    """A ROS node."""

    def __init__(
        self,
        *,
        executable: Text,
        package: Text = "",
        name: Text = "",
        namespace: Text = "",
        exec_name: Text = "",
        parameters: Iterable[Any] | None = None,
        remappings: Iterable[tuple[Text, Text]] | None = None,
        arguments: Any = None,
        ros_arguments: Iterable[Text] | None = None,
        env: dict[Text, Text] | None = None,
        additional_env: dict[Text, Text] | None = None,
        respawn: bool | Text = False,
        respawn_delay: float | None = None,
        on_exit: Any = None,
        **more: Any,
    ) -> None:
        super().__init__(**{key: value for key, value in more.items() if key not in IGNORED})
        self.package, self.executable = package, executable
        self.name, self.namespace, self.exec_name = name, namespace, exec_name
        self.parameters, self.remappings = list(parameters or ()), list(remappings or ())
        self.arguments = [arguments] if isinstance(arguments, str | Substitution) else list(arguments or ())
        self.ros_arguments = list(ros_arguments or ())
        self.env, self.additional_env = env, additional_env or {}
        self.respawn, self.respawn_delay = respawn, respawn_delay
        self.on_exit = on_exit if isinstance(on_exit, list | tuple) else [on_exit] if on_exit else []

    def execute(self, context: Context) -> None:
        """Add the node."""
        package, executable = perform(context, self.package), perform(context, self.executable)
        if not package:
            raise LaunchError(f"{executable} has no package: only executables of packages are started")
        if any(not isinstance(each, Shutdown) for each in self.on_exit):
            raise LaunchError("`on_exit` may only be Shutdown()")
        respawn = self.respawn if isinstance(self.respawn, bool) else perform(context, self.respawn).lower() == "true"
        remappings = [(perform(context, old), perform(context, new)) for old, new in self.remappings]
        with context.group():
            if self.env is not None:
                context.environment.clear()
            for name, value in {**(self.env or {}), **self.additional_env}.items():
                context.environment[perform(context, name)] = perform(context, value)
            context.add(
                {
                    "package": package,
                    "executable": executable,
                    "name": perform(context, self.name),
                    "namespace": joined(context.scope.namespace, perform(context, self.namespace)),
                    "arguments": [perform(context, each) for each in self.arguments],
                    "ros_arguments": [perform(context, each) for each in self.ros_arguments],
                    "parameters": [
                        *context.scope.parameters,
                        *(parameter_set(context, each) for each in self.parameters),
                    ],
                    "remappings": [*context.scope.remappings, *remappings],
                    "respawn": respawn,
                    "respawn_delay": float(self.respawn_delay or 0.0),
                    "required": bool(self.on_exit),
                }
            )


def joined(outer: str, inner: str) -> str:
    """Return a namespace within another one; one that begins with a slash stands for itself."""
    if inner.startswith("/") or not outer:
        return inner
    return f"{outer.rstrip('/')}/{inner}" if inner else outer


class PushRosNamespace(Action):
    """Puts a namespace in front of those of the nodes that follow in the group."""

    def __init__(self, namespace: Text, **more: Any) -> None:
        super().__init__(**more)
        self.namespace = namespace

    def execute(self, context: Context) -> None:
        """Add the namespace."""
        context.scope.namespace = joined(context.scope.namespace, perform(context, self.namespace))


class SetParameter(Action):
    """Sets a parameter of all nodes that follow in the group."""

    def __init__(self, name: Text, value: Any, **more: Any) -> None:
        super().__init__(**more)
        self.name, self.value = name, value

    def execute(self, context: Context) -> None:
        """Set it."""
        context.scope.parameters.append(parameter_set(context, {perform(context, self.name): self.value}))


class SetUseSimTime(SetParameter):
    """Sets whether the nodes that follow take their time from `/clock`."""

    def __init__(self, value: Any, **more: Any) -> None:
        super().__init__("use_sim_time", value, **more)


class SetParametersFromFile(Action):
    """Sets the parameters of a file for all nodes that follow in the group."""

    def __init__(self, filename: Text, **more: Any) -> None:
        super().__init__(**more)
        self.filename = filename

    def execute(self, context: Context) -> None:
        """Set them."""
        context.scope.parameters.append(parameter_set(context, self.filename))


class SetRemap(Action):
    """Gives a name of all nodes that follow in the group another one."""

    def __init__(self, src: Text, dst: Text, **more: Any) -> None:
        super().__init__(**more)
        self.src, self.dst = src, dst

    def execute(self, context: Context) -> None:
        """Set it."""
        context.scope.remappings.append((perform(context, self.src), perform(context, self.dst)))


def _is_text(value: Any) -> bool:
    return isinstance(value, str | Path | list | tuple) or hasattr(value, "perform")
