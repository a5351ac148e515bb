"""Settings that a launch file has made up to an action, and the nodes that it has described."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

MAX_NODES = 200
MAX_INCLUDES = 50  # files within one another


class LaunchError(Exception):
    """A launch file cannot be carried out; the text says where and why."""


@dataclass
class Scope:
    """Settings that a group restores at its end.

    Attributes:
        configurations: Values by the names of `LaunchConfiguration`.
        environment: Variables of the nodes.
        namespace: Namespace in front of those of nodes.
        remappings: Names of the nodes' code and the names in their place.
        parameters: Sets of parameters of all nodes.
    """

    configurations: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    namespace: str = ""
    remappings: list[tuple[str, str]] = field(default_factory=list)
    parameters: list[dict[str, Any]] = field(default_factory=list)

    def copy(self) -> Scope:
        """Return a scope that can be changed without a change of this one."""
        return replace(
            self,
            configurations=dict(self.configurations),
            environment=dict(self.environment),
            remappings=list(self.remappings),
            parameters=list(self.parameters),
        )


class Context:
    """State while a launch file is carried out; launch files know it as `LaunchContext`.

    Args:
        packages: Directories of packages, by name.
        arguments: Arguments of the launch file.
    """

    def __init__(self, packages: Mapping[str, str] | None = None, arguments: Mapping[str, str] | None = None) -> None:
        self.packages = dict(packages or {})
        self.arguments = dict(arguments or {})
        self.declared: dict[str, str] = {}  # descriptions of declared arguments
        self.read: set[str] = set()  # names of configurations that were read
        self.files: list[Path] = []  # under way, the innermost last
        self.nodes: list[dict[str, Any]] = []
        self.delay = 0.0  # seconds by which nodes start later
        self.scope = Scope(dict(self.arguments), dict(os.environ))
        self._saved: list[dict[str, str]] = []

    @property
    def launch_configurations(self) -> dict[str, str]:
        """Values by the names of `LaunchConfiguration`."""
        return self.scope.configurations

    @property
    def environment(self) -> dict[str, str]:
        """Variables of the nodes."""
        return self.scope.environment

    def perform_substitution(self, substitution: Any) -> str:
        """Return the text of a substitution."""
        return str(substitution.perform(self))

    def package(self, name: str) -> Path:
        """Return the directory of a package.

        Raises:
            LaunchError: There is no such package.
        """
        if name not in self.packages:
            raise LaunchError(f"this environment has no package {name}")
        return Path(self.packages[name])

    @contextmanager
    def group(self, scoped: bool = True, forwarding: bool = True) -> Iterator[None]:
        """Restore the scope at the end, unless not `scoped`; begin without configurations unless `forwarding`."""
        outer = self.scope
        if scoped:
            self.scope = outer.copy()
            if not forwarding:
                self.scope.configurations.clear()
        try:
            yield
        finally:
            if scoped:
                self.scope = outer

    def save_configurations(self) -> None:
        """Save the configurations for `restore_configurations`."""
        self._saved.append(dict(self.scope.configurations))

    def restore_configurations(self) -> None:
        """Restore the configurations that were saved last.

        Raises:
            LaunchError: None were saved.
        """
        if not self._saved:
            raise LaunchError("there are no launch configurations to restore")
        self.scope.configurations = self._saved.pop()

    @contextmanager
    def within(self, file: Path) -> Iterator[None]:
        """Carry out a file."""
        if len(self.files) >= MAX_INCLUDES:
            raise LaunchError(f"{file.name} is the {MAX_INCLUDES + 1}th file within others: does it include itself?")
        self.files.append(file)
        try:
            yield
        finally:
            self.files.pop()

    def add(self, node: dict[str, Any]) -> None:
        """Add a node.

        Raises:
            LaunchError: There are too many.
        """
        if len(self.nodes) >= MAX_NODES:
            raise LaunchError(f"there are more than {MAX_NODES} nodes: divide the launch file")
        changed = {key: value for key, value in self.environment.items() if os.environ.get(key) != value}
        removed = dict.fromkeys(os.environ.keys() - self.environment.keys())
        self.nodes.append({**node, "environment": {**changed, **removed}, "delay": self.delay})
