"""Classes of message and service types, by their ROS names."""

from __future__ import annotations

import importlib
from typing import Any

from rclpy.type_support import check_is_valid_msg_type, check_is_valid_srv_type

from endpoints.environment.definitions import InstalledTypes
from rce.errors import UnknownType
from rce.protocol.names import parse_type


def message_class(name: str, definitions: InstalledTypes) -> type[Any]:
    """Return the class of a message type.

    Raises:
        UnknownType: The type is not installed, or has no type support.
    """
    kind = _load(name, "msg", definitions)
    try:
        check_is_valid_msg_type(kind)
    except (RuntimeError, AttributeError, ImportError) as error:
        raise _no_type_support(name, str(error)) from None
    return kind


def service_class(name: str, definitions: InstalledTypes) -> type[Any]:
    """Return the class of a service type.

    Raises:
        UnknownType: The type is not installed, or has no type support.
    """
    kind = _load(name, "srv", definitions)
    try:
        check_is_valid_srv_type(kind)
    except (RuntimeError, AttributeError, ImportError) as error:
        raise _no_type_support(name, str(error)) from None
    return kind


def _load(name: str, sort: str, definitions: InstalledTypes) -> type[Any]:
    package, base = parse_type(name)
    definitions.find(package, sort, base)  # raises UnknownType, so that only packages with interfaces are imported
    try:
        kind: type[Any] = getattr(importlib.import_module(f"{package}.{sort}"), base)
    except (ImportError, AttributeError) as error:
        raise _no_type_support(name, str(error)) from None
    return kind


def _no_type_support(name: str, reason: str) -> UnknownType:
    return UnknownType(
        f"type {name} is defined in this environment, but its type support cannot be loaded ({reason}); "
        "build it with `python -m provisioning.typesupport`",
        field="className",
    )
