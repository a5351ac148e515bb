"""Classes of message, service and action types, by their ROS names."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from rclpy.type_support import check_for_type_support, check_is_valid_msg_type, check_is_valid_srv_type

from endpoints.environment.definitions import InstalledTypes
from rce.control.calls.robots import Sort
from rce.errors import UnknownType
from rce.protocol.names import parse_type


def message_class(name: str, definitions: InstalledTypes) -> type[Any]:
    """Return the class of a message type.

    Raises:
        UnknownType: The type is not installed, or has no type support.
    """
    return _load(name, "msg", check_is_valid_msg_type, definitions)


def service_class(name: str, definitions: InstalledTypes) -> type[Any]:
    """Return the class of a service type.

    Raises:
        UnknownType: The type is not installed, or has no type support.
    """
    return _load(name, "srv", check_is_valid_srv_type, definitions)


def action_class(name: str, definitions: InstalledTypes) -> type[Any]:
    """Return the class of an action type.

    Raises:
        UnknownType: The type is not installed, or has no type support.
    """
    return _load(name, "action", check_for_type_support, definitions)


def _load(name: str, sort: Sort, check: Callable[[Any], None], definitions: InstalledTypes) -> type[Any]:
    package, base = parse_type(name)
    definitions.find(package, sort, base)  # raises UnknownType, so that only packages with interfaces are imported
    try:
        kind: type[Any] = getattr(importlib.import_module(f"{package}.{sort}"), base)
        check(kind)
    except (ImportError, AttributeError, RuntimeError) as error:
        raise UnknownType(
            f"type {name} is defined in this environment, but its type support cannot be loaded ({error}); "
            "build it with `python -m provisioning.typesupport`",
            field="className",
        ) from None
    return kind
