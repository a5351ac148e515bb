"""The types of one user's robots and environments, beside the common ones: asked for whenever an interface is made.

What an environment has may change with the next version of a package, and bytes that are read by an older definition
make no sense. Interfaces keep the form in which they were made.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from converters.types import TypeRegistry, common_definitions
from rce.calls.endpoints import InterfaceSpec
from rce.calls.robots import Definitions
from rce.errors import AlreadyExists, UnknownType
from rce.names import parse_type

Ask = Callable[[str, bool], Awaitable[Definitions]]


class UserTypes:
    """`ask` finds the definition of a type (and whether it is a service's) in the user's environments; UnknownType."""

    def __init__(self, ask: Ask) -> None:
        self._ask = ask
        self._registry = TypeRegistry()

    async def of(self, spec: InterfaceSpec) -> TypeRegistry:
        """What knows the type of an interface as it is now. Where no environment has it, as it was known last."""
        name, service = parse_type(spec.type), spec.kind.startswith("Service")
        if (f"{name.srv}_Request" if service else name.msg) in common_definitions():
            return self._registry
        try:
            found = await self._ask(name.srv if service else name.msg, service)
        except UnknownType:
            return self._registry  # making the interface says what is unknown
        try:
            self._registry.learn(found.texts)
        except AlreadyExists:
            changed = TypeRegistry()
            changed.learn(found.texts)  # AlreadyExists again for what redefines a common type
            self._registry = changed
        return self._registry
