"""Conditions of actions."""

from __future__ import annotations

from endpoints.environment.launch.interpreter.context import Context
from endpoints.environment.launch.interpreter.substitutions import LaunchConfiguration, Text, perform, truth


class Condition:
    """Condition of an action: true if the action is carried out."""

    def evaluate(self, context: Context) -> bool:
        """Return True if the action is carried out; raise LaunchError if the condition is no truth value."""
        raise NotImplementedError


class IfCondition(Condition):
    """If a text is true."""

    def __init__(self, predicate_expression: Text) -> None:
        self.predicate_expression = predicate_expression

    def evaluate(self, context: Context) -> bool:
        """Return the truth of the text."""
        return truth(perform(context, self.predicate_expression))


class UnlessCondition(IfCondition):
    """If a text is false."""

    def evaluate(self, context: Context) -> bool:
        """Return the opposite of the truth of the text."""
        return not super().evaluate(context)


class LaunchConfigurationEquals(Condition):
    """If a configuration has a value; None: if it does not exist."""

    def __init__(self, launch_configuration_name: str, expected_value: Text | None) -> None:
        self.name, self.expected_value = launch_configuration_name, expected_value

    def evaluate(self, context: Context) -> bool:
        """Return whether the configuration has the value."""
        if self.name not in context.launch_configurations:
            return self.expected_value is None
        value = LaunchConfiguration(self.name).perform(context)
        return self.expected_value is not None and value == perform(context, self.expected_value)


class LaunchConfigurationNotEquals(LaunchConfigurationEquals):
    """If a configuration does not have a value."""

    def evaluate(self, context: Context) -> bool:
        """Return whether it does not."""
        return not super().evaluate(context)
