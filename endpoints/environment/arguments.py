"""The command line of a node: its arguments with their substitutions, its ROS name and its parameters."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from endpoints.environment.packages import Packages
from rce.calls.endpoints import NodeSpec
from rce.errors import InvalidName, InvalidRequest
from rce.names import GUEST

LONGEST = 100_000  # characters after substitution; Linux takes 128 KiB of one argument
_SUBSTITUTION = re.compile(r"\$\(\s*(\w+)\s+([^)\s]+)\s*\)")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
_NAMESPACE = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*|/", re.ASCII)


def substitute(text: str, packages: Packages, environment: Mapping[str, str], field: str = "args") -> str:
    """`$(find PKG)` is the directory of a package, `$(env VAR)` a variable. InvalidRequest, NotFound."""
    share = cache(packages.share)

    def value(match: re.Match[str]) -> str:
        kind, name = match.groups()
        if kind == "find":
            return str(share(name))
        if kind == "env" and name in environment:
            return environment[name]
        reason = f"the environment has no variable {name}" if kind == "env" else "known are $(find PKG) and $(env VAR)"
        raise InvalidRequest(f"{match[0]}: {reason}", field=field)

    found = _SUBSTITUTION.sub(value, text)
    if len(found) > max(LONGEST, len(text)):
        raise InvalidRequest(f"{field}: {len(found)} characters after substitution; {LONGEST} at most", field=field)
    return found


def split(text: str) -> list[str]:
    """The arguments as a shell would split them, without any other meaning of a shell. InvalidRequest."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InvalidRequest(f"args {text[:80]!r}: {error}", field="args") from None


def enclave(tag: str) -> str:
    """Of the node with this tag; those of guests' nodes (`@guest.node`) are no names for ROS as they are."""
    return "/" + tag.replace(GUEST, "_").replace(".", "_")


def ros_arguments(spec: NodeSpec, given: list[str], parameters: Path) -> list[str]:
    """What ROS 2 must know of a node; InvalidName.

    Its enclave is how its tag is found again among the nodes of ROS. ROS's own log files would grow without limit.
    """
    arguments = ["--ros-args", "--disable-external-lib-logs", "--params-file", str(parameters)]
    if "--enclave" not in given and "-e" not in given:
        arguments += ["--enclave", enclave(spec.tag)]
    if spec.name:
        arguments += ["-r", f"__node:={_checked(_NAME, spec.name, 'name')}"]
    if spec.namespace:
        arguments += ["-r", f"__ns:=/{_checked(_NAMESPACE, spec.namespace, 'namespace').lstrip('/')}"]
    return arguments


def _checked(rule: re.Pattern[str], value: str, field: str) -> str:
    if not rule.fullmatch(value):
        raise InvalidName(f"{field} {value[:80]!r} is not a legal {field} of a ROS 2 node", field=field)
    return value
