"""ROS context that joins its domain before its program is known.

A process that joins a domain misses what the others tell it before it knows them, and Fast DDS repeats that after
0.1 s. What a process adds when it knows the others is known to them within milliseconds.

rmw joins the domain with the first node of a context, and leaves it with the last. A hidden node stays there until the
program has a node of its own.
"""

from __future__ import annotations

import functools
import itertools
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions, install_signal_handlers
from rclpy.utilities import get_default_context

from endpoints.environment.prepared_node import ENCLAVE, NODE

PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE"
READ_ON_JOINING = ("ROS_", "RMW_", "RCL_", "RCUTILS_", "FASTDDS_", "FASTRTPS_")  # variables
READ_BY_INIT = ("--log-", "--enable-", "--disable-", "--enclave", "-e")  # options of a process, not of its nodes
ARGUMENTS = ("--ros-args", "--disable-external-lib-logs", "--enclave", ENCLAVE)


class PreparedContext:
    """The default context of this process, with which the program continues."""

    def __init__(self) -> None:
        """Join the domain of the variables of this process."""
        self._joined_with = _read_on_joining(os.environ)
        rclpy.init(args=list(ARGUMENTS), signal_handler_options=SignalHandlerOptions.NO)
        self._context = get_default_context()
        self._node: Node | None = rclpy.create_node(NODE, enable_rosout=False, start_parameter_services=False)

    def fits(self, arguments: Sequence[str], variables: Mapping[str, str]) -> bool:
        """Return whether a program with these arguments and variables would join the domain in the same way."""
        same = _read_by_init(arguments) == _read_by_init(ARGUMENTS)
        return same and _read_on_joining(variables) == self._joined_with

    def give(self) -> None:
        """Let the next `rclpy.init` of the default context continue with this one; nodes read `sys.argv`."""
        init, make = rclpy.init, Node.__init__

        @functools.wraps(init)
        def continue_with(
            *,
            args: list[str] | None = None,
            context: Context | None = None,
            domain_id: int | None = None,
            signal_handler_options: SignalHandlerOptions | None = None,
        ) -> _Given | rclpy.InitContextManager:
            if context not in {None, self._context}:
                return init(
                    args=args, context=context, domain_id=domain_id, signal_handler_options=signal_handler_options
                )
            rclpy.init = init
            if args in (None, sys.argv) and domain_id is None:
                return _Given(self._context, signal_handler_options)
            self.close()
            return init(args=args, domain_id=domain_id, signal_handler_options=signal_handler_options)

        @functools.wraps(make)
        def make_with_arguments(
            node: Node,
            *args: Any,
            context: Context | None = None,
            cli_args: list[str] | None = None,
            use_global_arguments: bool = True,
            **options: Any,
        ) -> None:
            if use_global_arguments and (context or get_default_context()) is self._context:
                cli_args = [*cli_args, "--", *sys.argv] if cli_args else sys.argv
            make(node, *args, context=context, cli_args=cli_args, use_global_arguments=use_global_arguments, **options)
            self._remove_node()

        rclpy.init = continue_with
        # rclpy has no hook for this: the arguments of a process are read by `rclpy.init` alone.
        Node.__init__ = make_with_arguments  # type: ignore[method-assign, assignment]

    def close(self) -> None:
        """Leave the domain."""
        self._remove_node()
        rclpy.shutdown()

    def _remove_node(self) -> None:
        if self._node is not None:
            self._node.destroy_node()
            self._node = None


class _Given(rclpy.InitContextManager):
    """Manage a context that was initialized before, as the result of `rclpy.init` manages its own."""

    def __init__(self, context: Context, signal_handlers: SignalHandlerOptions | None) -> None:
        if signal_handlers is None:
            signal_handlers = SignalHandlerOptions.ALL
        self.context = context
        self.installed_signal_handlers = signal_handlers != SignalHandlerOptions.NO
        install_signal_handlers(signal_handlers)


def _read_by_init(arguments: Sequence[str]) -> set[tuple[str, str]]:
    """Return the options of a process among the arguments of a program, with their values."""
    return {
        (option, "" if value.startswith("-") else value)
        for option, value in itertools.pairwise([*arguments, "-"])
        if option.startswith(READ_BY_INIT)
    }


def _read_on_joining(variables: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that have an effect when a process joins a domain, and the contents of the profile."""
    found = {name: value for name, value in variables.items() if name.startswith(READ_ON_JOINING)}
    profile = found.get(PROFILES)
    return {**found, PROFILES: Path(profile).read_text()} if profile else found
