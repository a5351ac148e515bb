"""Substitutions: texts that are known only when a launch file is carried out."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from endpoints.environment.launch.interpreter.context import Context, LaunchError

TRUE, FALSE = ("true", "1"), ("false", "0")


class Substitution:
    """A text that is known only when the launch file is carried out."""

    def perform(self, context: Context) -> str:
        """Return the text."""
        raise NotImplementedError

    def __add__(self, other: Any) -> list[Any]:
        return [self, *(other if isinstance(other, list) else [other])]

    def __radd__(self, other: Any) -> list[Any]:
        return [*(other if isinstance(other, list) else [other]), self]


Text = str | Path | Substitution | Iterable[Any]
"""Texts that an action takes: a string, a path, a substitution, or several of these, which are joined."""


def perform(context: Context, text: Text) -> str:
    """Return the text that strings, paths and substitutions make together.

    Raises:
        LaunchError: Something else is among them.
    """
    if isinstance(text, str | Path):
        return str(text)
    if isinstance(text, Substitution):
        return text.perform(context)
    if hasattr(text, "perform"):  # of a class of the launch file's own
        return str(text.perform(context))
    if not isinstance(text, Iterable):
        raise LaunchError(f"{text!r} is not a text, a substitution or a list of these")
    return "".join(perform(context, part) for part in text)


def truth(text: str) -> bool:
    """Return the truth of a text, as conditions understand it.

    Raises:
        LaunchError: It is neither true nor false.
    """
    plain = text.strip().lower()
    if plain not in TRUE + FALSE:
        raise LaunchError(f"{text!r} is neither true nor false: use one of {', '.join(TRUE + FALSE)}")
    return plain in TRUE


def truth_text(value: bool) -> str:
    """Return the text of a truth."""
    return "true" if value else "false"


class TextSubstitution(Substitution):
    """A constant."""

    def __init__(self, *, text: str) -> None:
        self.text = text

    def perform(self, context: Context) -> str:
        """Return the text."""
        return self.text


class LaunchConfiguration(Substitution):
    """Value of an argument or of another configuration."""

    def __init__(self, variable_name: Text, *, default: Text | None = None) -> None:
        self.variable_name, self.default = variable_name, default

    def perform(self, context: Context) -> str:
        """Return the value; raise LaunchError if there is none."""
        name = perform(context, self.variable_name)
        context.read.add(name)
        if name in context.launch_configurations:
            return context.launch_configurations[name]
        if self.default is None:
            raise LaunchError(f"there is no launch configuration {name}: declare an argument of this name before")
        return perform(context, self.default)


class EnvironmentVariable(Substitution):
    """Value of a variable of the environment."""

    def __init__(self, name: Text, *, default_value: Text | None = None) -> None:
        self.name, self.default_value = name, default_value

    def perform(self, context: Context) -> str:
        """Return the value; raise LaunchError if there is none."""
        name = perform(context, self.name)
        if name in context.environment:
            return context.environment[name]
        if self.default_value is None:
            raise LaunchError(f"the environment has no variable {name}")
        return perform(context, self.default_value)


class PathJoinSubstitution(Substitution):
    """Parts of a path, joined."""

    def __init__(self, substitutions: Iterable[Text]) -> None:
        self.substitutions = list(substitutions)

    def perform(self, context: Context) -> str:
        """Return the path."""
        return os.path.join(*(perform(context, part) for part in self.substitutions))


class PythonExpression(Substitution):
    """Value of a Python expression; names of `math` and of `python_modules` may be used in it."""

    def __init__(self, expression: Text, python_modules: Iterable[Text] = ("math",)) -> None:
        self.expression, self.python_modules = expression, python_modules

    def perform(self, context: Context) -> str:
        """Return the value as text; raise LaunchError if the expression fails."""
        text = perform(context, self.expression)
        names: dict[str, Any] = dict(vars(math))
        try:
            for module in self.python_modules:
                name = perform(context, module)
                names[name.partition(".")[0]] = __import__(name)
            return str(eval(text, names))
        except Exception as error:  # noqa: BLE001  # of the user's code
            raise LaunchError(f"expression {text[:200]!r}: {error}") from None


class ThisLaunchFile(Substitution):
    """Path of the launch file."""

    def perform(self, context: Context) -> str:
        """Return the path."""
        return str(context.files[-1])


class ThisLaunchFileDir(Substitution):
    """Directory of the launch file."""

    def perform(self, context: Context) -> str:
        """Return the path."""
        return str(context.files[-1].parent)


class FindPackageShare(Substitution):
    """Directory of a package with its launch and configuration files."""

    def __init__(self, package: Text) -> None:
        self.package = package

    def perform(self, context: Context) -> str:
        """Return the path; raise LaunchError if there is no such package."""
        return str(context.package(perform(context, self.package)))


class FindPackagePrefix(FindPackageShare):
    """Install prefix of a package; of a package in sources, its directory."""

    def perform(self, context: Context) -> str:
        """Return the path; raise LaunchError if there is no such package."""
        return str(prefix_of(context.package(perform(context, self.package))))


def prefix_of(share: Path) -> Path:
    """Return the install prefix of a package with this directory."""
    return share.parents[1] if share.parent.name == "share" else share


class FindExecutable(Substitution):
    """Path of a program."""

    def __init__(self, *, name: Text) -> None:
        self.name = name

    def perform(self, context: Context) -> str:
        """Return the path; raise LaunchError if there is no such program."""
        name = perform(context, self.name)
        path = shutil.which(name, path=context.environment.get("PATH"))
        if path is None:
            raise LaunchError(f"there is no program {name} on the PATH")
        return path


class NotSubstitution(Substitution):
    """The opposite of a truth."""

    def __init__(self, value: Text) -> None:
        self.value = value

    def perform(self, context: Context) -> str:
        """Return `true` or `false`."""
        return truth_text(not truth(perform(context, self.value)))


class AllSubstitution(Substitution):
    """Text `true` if all texts are true, else `false`."""

    def __init__(self, *values: Text) -> None:
        self.values = values

    def perform(self, context: Context) -> str:
        """Return `true` or `false`."""
        return truth_text(all(truth(perform(context, value)) for value in self.values))


class AnySubstitution(AllSubstitution):
    """Text `true` if one of the texts is true, else `false`."""

    def perform(self, context: Context) -> str:
        """Return `true` or `false`."""
        return truth_text(any(truth(perform(context, value)) for value in self.values))


class AndSubstitution(AllSubstitution):
    """Text `true` if two texts are true, else `false`."""

    def __init__(self, left: Text, right: Text) -> None:
        super().__init__(left, right)


class OrSubstitution(AnySubstitution):
    """Text `true` if one of two texts is true, else `false`."""

    def __init__(self, left: Text, right: Text) -> None:
        super().__init__(left, right)


class EqualsSubstitution(AndSubstitution):
    """Text `true` if two texts are equal, else `false`; numbers and truths count by their value."""

    def perform(self, context: Context) -> str:
        """Return `true` or `false`."""
        left, right = (_plain(perform(context, value)) for value in self.values)
        return truth_text(left == right)


class NotEqualsSubstitution(EqualsSubstitution):
    """Text `true` if two texts differ, else `false`."""

    def perform(self, context: Context) -> str:
        """Return `true` or `false`."""
        return truth_text(not truth(super().perform(context)))


def _plain(text: str) -> str | float | bool:
    if text.lower() in TRUE + FALSE:
        return truth(text)
    try:
        return float(text)
    except ValueError:
        return text


class IfElseSubstitution(Substitution):
    """One of two texts, by a third one."""

    def __init__(self, condition: Text, if_value: Text = "", else_value: Text = "") -> None:
        self.condition, self.if_value, self.else_value = condition, if_value, else_value

    def perform(self, context: Context) -> str:
        """Return the text."""
        return perform(context, self.if_value if truth(perform(context, self.condition)) else self.else_value)
