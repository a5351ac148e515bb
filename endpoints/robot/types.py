"""Types of one user's robots and environments, beside the common ones.

A definition is looked up whenever an interface is created, because the next version of a package may change it, and
messages that are decoded with an older definition are garbage. An interface keeps the definition it was created with.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from converters.types import TypeRegistry, common_definitions
from rce.control.calls.endpoints import InterfaceSpec
from rce.control.calls.robots import Definitions
from rce.errors import AlreadyExists, UnknownType
from rce.protocol.names import parse_type

Lookup = Callable[[str, bool], Awaitable[Definitions]]


class UserTypes:
    """Registry of one user's types.

    Args:
        lookup: Returns the definition of a type from the user's environments, given its name and whether it is a
            service; raises UnknownType when no environment has it.
    """

    def __init__(self, lookup: Lookup) -> None:
        self._lookup = lookup
        self._registry = TypeRegistry()

    async def registry_for(self, spec: InterfaceSpec) -> TypeRegistry:
        """Return a registry with the present definition of an interface's type, or the last known one.

        Raises:
            AlreadyExists: The definition redefines a common type.
        """
        name, service = parse_type(spec.type), spec.kind.startswith("Service")
        if (f"{name.srv}_Request" if service else name.msg) in common_definitions():
            return self._registry
        try:
            found = await self._lookup(name.srv if service else name.msg, service)
        except UnknownType:
            return self._registry  # creating the interface raises the error with the name that is unknown
        try:
            self._registry.add(found.texts)
        except AlreadyExists:
            changed = TypeRegistry()
            changed.add(found.texts)  # raises AlreadyExists again if a common type is redefined
            self._registry = changed
        return self._registry
