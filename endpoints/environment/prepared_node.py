"""Interpreter that waits in its ROS domain for a node: `python -m endpoints.environment.prepared_node PARENT`.

It becomes the node of a package that comes with RCE, whose program is a Python file; other nodes are started anew. The
node is a line of JSON on standard input: command, variables and working directory.
"""

from __future__ import annotations

import asyncio
import importlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rce.process import malloc

if TYPE_CHECKING:
    from endpoints.environment.prepared_context import PreparedContext

LOADED = ("rclpy.action", "rclpy.executors", "rclpy.node", "std_msgs.msg")  # modules that nearly every node needs
NODE = "_rce_prepared"  # that holds the domain; a leading underscore hides it from lists of nodes
ENCLAVE = "/_rce_prepared"  # of its process, which joins its domain before the tag of the node is known
END_TIMEOUT = 1.0  # seconds in which it leaves its domain, so that no shared memory is left
LIBRARIES = "LD_LIBRARY_PATH"  # has an effect only when a process starts


class Spare:
    """A waiting interpreter; `take` gives it away once."""

    def __init__(
        self, process: asyncio.subprocess.Process | None = None, variables: Mapping[str, str] | None = None
    ) -> None:
        self._process = process
        self._variables = variables or {}

    def suits(self, command: Sequence[str], variables: Mapping[str, str]) -> bool:
        """Return whether there is a process that can become the node with this command."""
        waiting = self._process is not None and self._process.returncode is None
        return waiting and command[0] == sys.executable and _libraries(variables) == _libraries(self._variables)

    def take(self, command: Sequence[str], variables: Mapping[str, str], directory: Path) -> asyncio.subprocess.Process:
        """Return the process, which becomes a node that it suits."""
        process, self._process = self._process, None
        assert process is not None
        assert process.stdin is not None
        order = {"command": list(command[1:]), "variables": dict(variables), "directory": str(directory)}
        process.stdin.write(json.dumps(order).encode() + b"\n")
        process.stdin.close()
        return process

    async def discard(self) -> None:
        """End the process unless it was taken."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            async with asyncio.timeout(END_TIMEOUT):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()


def _libraries(variables: Mapping[str, str]) -> set[str]:
    """Return the directories of libraries, without those of ROS 2 itself, whose modules load their own."""
    return {each for each in variables.get(LIBRARIES, "").split(os.pathsep) if not each.startswith(sys.prefix)}


async def start() -> Spare:
    """Start an interpreter; it ends with this process."""
    variables = {**os.environ, **malloc.VARIABLES, "PYTHONUNBUFFERED": "1"}
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", "endpoints.environment.prepared_node", str(os.getpid())),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env=variables,
        start_new_session=True,
    )
    return Spare(process, variables)


def main() -> None:
    """Load rclpy, join the domain, wait for the node, and become it."""
    from endpoints.environment.launcher import end_with

    end_with(int(sys.argv[1]))
    typesupport = [each for each in os.environ.get("RCE_TYPESUPPORT", "").split(",") if each]
    sys.path += [str(Path(each) / "python") for each in typesupport]
    for module in LOADED:
        importlib.import_module(module)
    from endpoints.environment.prepared_context import PROFILES, PreparedContext

    context = PreparedContext()
    Path(os.environ[PROFILES]).unlink(missing_ok=True)
    line = sys.stdin.buffer.readline()
    if line:
        become(json.loads(line), context)
    else:
        context.close()


def become(order: dict[str, object], context: PreparedContext | None = None) -> None:
    """Run the program of an order in this process, as the interpreter would, with this context if it fits."""
    import runpy

    command, variables = order["command"], order["variables"]
    assert isinstance(command, list)
    assert isinstance(variables, dict)
    os.environ.clear()
    os.environ.update(variables)
    os.chdir(str(order["directory"]))
    paths = [each for each in variables.get("PYTHONPATH", "").split(os.pathsep) if each]
    sys.path[:] = [str(Path(command[0]).parent), *paths, *(each for each in sys.path if each not in paths)]
    sys.argv = command
    if context is not None:
        (context.give if context.fits(command, variables) else context.close)()
    runpy.run_path(command[0], run_name="__main__")


if __name__ == "__main__":
    main()
