"""Types of one user's robots and environments, beside the common ones.

A definition is looked up whenever an interface is created, because the next version of a package may change it, and
messages that are decoded with an older definition are garbage. An interface keeps the definition it was created with.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from converters.types import TypeRegistry, common_definitions
from rce.control.calls.endpoints import InterfaceSpec
from rce.control.calls.robots import Definitions, Sort
from rce.errors import AlreadyExists, UnknownType
from rce.protocol.names import TypeName, parse_type

Lookup = Callable[[str, Sort], Awaitable[Definitions]]


def sort_of(kind: str) -> Sort:
    """Return the sort of the types of an interface, given the interface's kind."""
    return "srv" if kind.startswith("Service") else "action" if kind.startswith("Action") else "msg"


class UserTypes:
    """Registry of one user's types.

    Args:
        lookup: Returns the definition of a type from the user's environments, given its name and sort; raises
            UnknownType when no environment has it.
    """

    def __init__(self, lookup: Lookup) -> None:
        self._lookup = lookup
        self._registry = TypeRegistry()

    async def registry_for(self, spec: InterfaceSpec) -> TypeRegistry:
        """Return a registry with the present definition of an interface's type, or the last known one.

        Raises:
            AlreadyExists: The definition redefines a common type.
        """
        return await self.registry_of(parse_type(spec.type), sort_of(spec.kind))

    async def registry_of(self, name: TypeName, sort: Sort) -> TypeRegistry:
        """Return a registry with the present definition of a type; see `registry_for`."""
        full = {"msg": name.msg, "srv": name.srv, "action": name.action}[sort]
        if {"msg": full, "srv": f"{full}_Request", "action": f"{full}_Goal"}[sort] in common_definitions():
            return self._registry
        try:
            found = await self._lookup(full, sort)
        except UnknownType:
            return self._registry  # creating the interface raises the error with the name that is unknown
        try:
            self._registry.add(found.texts)
        except AlreadyExists:
            changed = TypeRegistry()
            changed.add(found.texts)  # raises AlreadyExists again if a common type is redefined
            self._registry = changed
        return self._registry
