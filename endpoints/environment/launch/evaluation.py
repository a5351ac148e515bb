"""Evaluation of a launch file: it is carried out by the interpreter in a process of its own, as it is user code."""

from __future__ import annotations

import asyncio
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from endpoints.environment.node import NodeProcess
from endpoints.environment.output_log import OutputLog
from endpoints.environment.parameters import params_file
from rce.control.calls.endpoints import NodeSpec
from rce.errors import InvalidRequest

PROGRAM = "endpoints.environment.launch.interpreter"
TIMEOUT = 30.0  # seconds for a launch file; a start has 60
LAST_LINES = 20


class LaunchedNode(Struct, frozen=True):
    """A node that a launch file describes.

    Attributes:
        parameters: Sets of parameters: `values` by name, a `file`, or the `text` of a file.
        environment: Variables; None removes one.
        delay: Seconds after which it starts.
        required: The launch ends with this node.
    """

    package: str
    executable: str
    name: str = ""
    namespace: str = ""
    arguments: list[str] = []
    ros_arguments: list[str] = []
    parameters: list[dict[str, Any]] = []
    remappings: list[tuple[str, str]] = []
    environment: dict[str, str | None] = {}
    delay: float = 0.0
    respawn: bool = False
    respawn_delay: float = 0.0
    required: bool = False

    def command_arguments(self, directory: Path) -> list[str]:
        """Return its arguments; parameters are written into files in a directory."""
        ros = [word for old, new in self.remappings for word in ("-r", f"{old}:={new}")]
        for number, each in enumerate(self.parameters):
            path = Path(each["file"]) if "file" in each else directory / f"launch_{number}.yaml"
            if "file" not in each:
                path.write_text(each["text"] if "text" in each else params_file(each["values"].items()))
            ros += ["--params-file", str(path)]
        ros += self.ros_arguments
        return [*self.arguments, *(["--ros-args", *ros, "--"] if ros else [])]


class _Result(Struct, frozen=True):
    nodes: list[LaunchedNode] = []
    error: str = ""


def launch_arguments(words: list[str]) -> dict[str, str]:
    """Return the arguments of a launch file; raise InvalidRequest for a word that is not NAME:=VALUE."""
    found = {}
    for word in words:
        name, sign, value = word.partition(":=")
        if not sign or not name:
            raise InvalidRequest(f"argument {word[:80]!r} of the launch file: write NAME:=VALUE", field="args")
        found[name] = value
    return found


async def evaluate(
    spec: NodeSpec,
    file: Path,
    arguments: Mapping[str, str],
    packages: Mapping[str, str],
    variables: Mapping[str, str],
    directory: Path,
    home: Path,
    output: OutputLog,
) -> list[LaunchedNode]:
    """Return the nodes that a launch file describes.

    Args:
        spec: The launch.
        file: Its launch file.
        arguments: Arguments by name.
        packages: Directories of packages by name.
        variables: Variables of the process, which can import this program.
        directory: Directory for files of the launch.
        home: Working directory.
        output: Gets what the launch file prints.

    Raises:
        InvalidRequest: The launch file is wrong; the message has its name and line.
        StartFailed: The interpreter cannot be executed.
    """
    request, result = directory / "request.json", directory / "result.json"
    request.write_bytes(msgspec.json.encode({"file": str(file), "arguments": arguments, "packages": packages}))
    result.unlink(missing_ok=True)
    own = OutputLog(directory / "interpreter.log")
    command = [sys.executable, "-P", "-m", PROGRAM, str(request), str(result)]
    process = await NodeProcess.start(spec, command, variables, home, own, lambda *_: None)
    try:
        async with asyncio.timeout(TIMEOUT):
            status = await asyncio.shield(process.over)
    except TimeoutError:
        raise InvalidRequest(f"{file.name} did not end within {TIMEOUT:g} s", field="launch") from None
    finally:
        if not process.over.done():
            await process.stop()
        output.write("".join(f"{line}\n" for line in own.last_lines(LAST_LINES)).encode())
    return _read(result, file, status, own)


def _read(result: Path, file: Path, status: int, log: OutputLog) -> list[LaunchedNode]:
    if not result.exists():
        lines = "; ".join(log.last_lines(3))
        raise InvalidRequest(f"{file.name} ended the interpreter with status {status}: {lines}", field="launch")
    try:
        found = msgspec.json.decode(result.read_bytes(), type=_Result)
    except msgspec.MsgspecError as error:
        raise InvalidRequest(f"{file.name} describes a node with a value of a wrong type: {error}") from None
    if found.error:
        raise InvalidRequest(found.error, field="launch")
    if not found.nodes:
        raise InvalidRequest(f"{file.name} describes no node with these arguments", field="launch")
    return found.nodes


def tags(nodes: list[LaunchedNode], launch: str) -> list[str]:
    """Return the tags of the nodes of a launch: `LAUNCH.NAMESPACE.NAME`, with numbers where names are the same."""
    found: list[str] = []
    for node in nodes:
        name = node.name or Path(node.executable).name.removesuffix(".py")
        plain = ".".join([launch, *node.namespace.strip("/").split("/"), name] if node.namespace else [launch, name])
        plain = "".join(letter if letter.isalnum() or letter in "._@" else "_" for letter in plain)
        same = sum(each == plain or each.rpartition("_")[0] == plain for each in found)
        found.append(f"{plain}_{same + 1}" if same else plain)
    return found


def node_spec(node: LaunchedNode, tag: str) -> NodeSpec:
    """Return a node of a launch as the Master knows it."""
    return NodeSpec(tag, node.package, node.executable, shlex.join(node.arguments), node.name, node.namespace)
