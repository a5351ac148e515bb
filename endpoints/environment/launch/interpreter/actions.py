"""Actions of launch files which do not concern ROS."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from endpoints.environment.launch.interpreter.conditions import Condition
from endpoints.environment.launch.interpreter.context import Context, LaunchError
from endpoints.environment.launch.interpreter.substitutions import Text, perform

HERE = str(Path(__file__).parent)


def caller() -> str:
    """Return the line outside of the interpreter that is being executed, as FILE:LINE."""
    frame = sys._getframe(1)
    while frame.f_code.co_filename.startswith(HERE) and frame.f_back is not None:
        frame = frame.f_back
    return f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"


class Action:
    """One step of a launch file.

    Attributes:
        where: Its place, as FILE:LINE.
    """

    def __init__(self, *, condition: Condition | None = None, **unknown: Any) -> None:
        self.condition = condition
        self.where = caller()
        if unknown:
            raise LaunchError(f"{self.where}: {type(self).__name__}: {', '.join(sorted(unknown))} is not supported")

    def visit(self, context: Context) -> None:
        """Carry the action out if its condition holds; raise LaunchError with its place."""
        try:
            if self.condition is None or self.condition.evaluate(context):
                self.execute(context)
        except _Placed:
            raise
        except LaunchError as error:
            raise _Placed(f"{self.where}: {type(self).__name__}: {error}") from None

    def execute(self, context: Context) -> None:
        """Carry the action out."""
        raise NotImplementedError


class _Placed(LaunchError):
    """An error that names its place."""


def visit_all(context: Context, actions: Iterable[Any] | None) -> None:
    """Carry out actions in their order.

    Raises:
        LaunchError: One of them fails, or is none.
    """
    for each in actions or ():
        if not hasattr(each, "visit"):
            raise LaunchError(f"{each!r} is not an action")
        each.visit(context)


class LaunchDescription(Action):
    """The actions of a launch file."""

    def __init__(self, initial_entities: Iterable[Any] | None = None) -> None:
        super().__init__()
        self.entities = list(initial_entities or ())

    def add_action(self, action: Any) -> None:
        """Add an action at the end."""
        self.entities.append(action)

    add_entity = add_action

    def execute(self, context: Context) -> None:
        """Carry all actions out."""
        visit_all(context, self.entities)


class DeclareLaunchArgument(Action):
    """Argument of the launch file."""

    def __init__(
        self,
        name: str,
        *,
        default_value: Text | None = None,
        description: Text = "",
        choices: Iterable[str] | None = None,
        **more: Any,
    ) -> None:
        super().__init__(**more)
        self.name, self.default_value, self.description = name, default_value, description
        self.choices = None if choices is None else list(choices)

    def execute(self, context: Context) -> None:
        """Give the argument its default unless it was given; raise LaunchError if it has none or a wrong value."""
        context.declared[self.name] = perform(context, self.description)
        if self.name not in context.launch_configurations:
            if self.default_value is None:
                raise LaunchError(f"the argument {self.name} is missing: give it as {self.name}:=VALUE")
            context.launch_configurations[self.name] = perform(context, self.default_value)
        value = context.launch_configurations[self.name]
        if self.choices is not None and value not in self.choices:
            raise LaunchError(f"the argument {self.name} is {value!r}, not one of {', '.join(self.choices)}")


class SetLaunchConfiguration(Action):
    """Sets a configuration."""

    def __init__(self, name: Text, value: Text, **more: Any) -> None:
        super().__init__(**more)
        self.name, self.value = name, value

    def execute(self, context: Context) -> None:
        """Set it."""
        context.launch_configurations[perform(context, self.name)] = perform(context, self.value)


class UnsetLaunchConfiguration(Action):
    """Removes a configuration."""

    def __init__(self, name: Text, **more: Any) -> None:
        super().__init__(**more)
        self.name = name

    def execute(self, context: Context) -> None:
        """Remove it, if it exists."""
        context.launch_configurations.pop(perform(context, self.name), None)


class PushLaunchConfigurations(Action):
    """Saves all configurations."""

    def execute(self, context: Context) -> None:
        """Save them."""
        context.save_configurations()


class PopLaunchConfigurations(Action):
    """Restores the configurations that were saved last."""

    def execute(self, context: Context) -> None:
        """Restore them."""
        context.restore_configurations()


class SetEnvironmentVariable(Action):
    """Sets a variable of the nodes that follow."""

    def __init__(self, name: Text, value: Text, **more: Any) -> None:
        super().__init__(**more)
        self.name, self.value = name, value

    def execute(self, context: Context) -> None:
        """Set it."""
        context.environment[perform(context, self.name)] = perform(context, self.value)


class AppendEnvironmentVariable(SetEnvironmentVariable):
    """Adds to a variable of the nodes that follow."""

    def __init__(self, name: Text, value: Text, prepend: Text | bool = False, separator: Text = ":", **more: Any):
        super().__init__(name, value, **more)
        self.prepend, self.separator = prepend, separator

    def execute(self, context: Context) -> None:
        """Add to it."""
        name, value = perform(context, self.name), perform(context, self.value)
        first = self.prepend if isinstance(self.prepend, bool) else perform(context, self.prepend).lower() == "true"
        parts = [part for part in (context.environment.get(name), value) if part]
        context.environment[name] = perform(context, self.separator).join(parts[::-1] if first else parts)


class UnsetEnvironmentVariable(Action):
    """Removes a variable of the nodes that follow."""

    def __init__(self, name: Text, **more: Any) -> None:
        super().__init__(**more)
        self.name = name

    def execute(self, context: Context) -> None:
        """Remove it, if it exists."""
        context.environment.pop(perform(context, self.name), None)


class LogInfo(Action):
    """Writes a line into the log of the launch."""

    def __init__(self, *, msg: Text, **more: Any) -> None:
        super().__init__(**more)
        self.msg = msg

    def execute(self, context: Context) -> None:
        """Write it."""
        print(perform(context, self.msg), flush=True)


class GroupAction(Action):
    """Actions whose settings end with them, unless the group is not `scoped`."""

    def __init__(
        self,
        actions: Iterable[Any],
        *,
        scoped: bool = True,
        forwarding: bool = True,
        launch_configurations: dict[Text, Text] | None = None,
        **more: Any,
    ) -> None:
        super().__init__(**more)
        self.actions, self.scoped, self.forwarding = list(actions), scoped, forwarding
        self.configurations = launch_configurations or {}

    def execute(self, context: Context) -> None:
        """Carry the actions out."""
        given = {perform(context, name): perform(context, value) for name, value in self.configurations.items()}
        with context.group(self.scoped, self.forwarding):
            context.launch_configurations.update(given)
            visit_all(context, self.actions)


class TimerAction(Action):
    """Actions that are carried out later; only nodes can wait."""

    def __init__(self, *, period: Any, actions: Iterable[Any], **more: Any) -> None:
        more.pop("cancel_on_shutdown", None)  # what waits is never started after the end
        super().__init__(**more)
        self.period, self.actions = period, list(actions)

    def execute(self, context: Context) -> None:
        """Carry the actions out, so that their nodes start later."""
        text = str(self.period) if isinstance(self.period, int | float) else perform(context, self.period)
        try:
            seconds = float(text)
        except ValueError:
            raise LaunchError(f"the period {text!r} is not a number of seconds") from None
        before = context.delay
        context.delay += seconds
        try:
            visit_all(context, self.actions)
        finally:
            context.delay = before


class OpaqueFunction(Action):
    """Function that returns actions, given the context."""

    def __init__(
        self,
        *,
        function: Callable[..., Iterable[Any] | None],
        args: Iterable[Any] = (),
        kwargs: dict[str, Any] | None = None,
        **more: Any,
    ) -> None:
        super().__init__(**more)
        self.function, self.args, self.kwargs = function, list(args), kwargs or {}

    def execute(self, context: Context) -> None:
        """Call it, and carry out what it returns."""
        visit_all(context, self.function(context, *self.args, **self.kwargs))


class Shutdown(Action):
    """Ends the launch. It is supported as `on_exit` of a node only."""

    def __init__(self, *, reason: Text = "", **more: Any) -> None:
        super().__init__(**more)

    def execute(self, context: Context) -> None:
        """Raise LaunchError."""
        raise LaunchError("is supported as `on_exit` of a node only")
