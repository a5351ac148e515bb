"""Command line of a node: its arguments with substitutions, its ROS name and its parameters."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from endpoints.environment.packages import Packages
from rce.control.calls.endpoints import NodeSpec
from rce.errors import InvalidName, InvalidRequest
from rce.protocol.names import GUEST_PREFIX

MAX_LENGTH = 100_000  # characters after substitution; Linux limits one argument to 128 KiB
_SUBSTITUTION = re.compile(r"\$\(\s*(\w+)\s+([^)\s]+)\s*\)")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
_NAMESPACE = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*|/", re.ASCII)


def substitute(text: str, packages: Packages, environment: Mapping[str, str], field: str = "args") -> str:
    """Replace `$(find PKG)` by the directory of a package and `$(env VAR)` by a variable.

    Raises:
        InvalidRequest: A substitution is unknown, a variable is not set, or the result is too long.
        NotFound: There is no such package.
    """
    share = cache(packages.share)

    def value(match: re.Match[str]) -> str:
        kind, name = match.groups()
        if kind == "find":
            return str(share(name))
        if kind == "env" and name in environment:
            return environment[name]
        reason = f"the environment has no variable {name}" if kind == "env" else "use $(find PKG) or $(env VAR)"
        raise InvalidRequest(f"{match[0]}: {reason}", field=field)

    found = _SUBSTITUTION.sub(value, text)
    if len(found) > max(MAX_LENGTH, len(text)):
        raise InvalidRequest(
            f"{field} has {len(found)} characters after substitution; the limit is {MAX_LENGTH}", field=field
        )
    return found


def split(text: str) -> list[str]:
    """Split arguments as a shell does, without other shell syntax; raise InvalidRequest for unbalanced quotes."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InvalidRequest(f"args {text[:80]!r}: {error}", field="args") from None


def enclave(tag: str) -> str:
    """Return the enclave of the node with this tag; guests' tags (`@guest.node`) are made valid ROS names."""
    return "/" + tag.replace(GUEST_PREFIX, "_").replace(".", "_")


def ros_arguments(spec: NodeSpec, given: list[str], parameters: Path, place: str = "") -> list[str]:
    """Return the ROS arguments of a node.

    The enclave identifies the node in the ROS graph. Log files of ROS are disabled, because they would grow without
    limit.

    Args:
        spec: The node.
        given: Arguments of the user, which may name another enclave.
        parameters: Path of the node's parameter file.
        place: Enclave of the node; empty for that of its tag.

    Raises:
        InvalidName: The name or the namespace is not valid in ROS 2.
    """
    arguments = ["--ros-args", "--disable-external-lib-logs", "--params-file", str(parameters)]
    if "--enclave" not in given and "-e" not in given:
        arguments += ["--enclave", place or enclave(spec.tag)]
    if spec.name:
        arguments += ["-r", f"__node:={_checked(_NAME, spec.name, 'name')}"]
    if spec.namespace:
        arguments += ["-r", f"__ns:=/{_checked(_NAMESPACE, spec.namespace, 'namespace').lstrip('/')}"]
    return arguments


def _checked(rule: re.Pattern[str], value: str, field: str) -> str:
    if not rule.fullmatch(value):
        raise InvalidName(f"{field} {value[:80]!r} is not a valid {field} of a ROS 2 node", field=field)
    return value
