"""Records of their own shape: until 0.1 they embedded the arguments of control calls and the messages of robots."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

records = sa.table("records", sa.column("kind", sa.String), sa.column("key", sa.String), sa.column("value", sa.Text))


def upgrade() -> None:
    """Rewrite the records whose shape changed."""
    connection = op.get_bind()
    query = sa.select(records.c.kind, records.c.key, records.c.value).where(records.c.kind.in_(list(CHANGES)))
    for kind, key, value in connection.execute(query).all():
        changed = json.dumps(CHANGES[kind](json.loads(value)), ensure_ascii=False)
        this = sa.and_(records.c.kind == kind, records.c.key == key)
        connection.execute(records.update().where(this).values(value=changed))


def _node(old: dict[str, Any]) -> dict[str, Any]:
    new = {"owner": old["owner"], **old["spec"]}
    return _renamed(new, {"pkg": "package", "exe": "executable", "args": "arguments"})


def _parameter(old: dict[str, Any]) -> dict[str, Any]:
    return {"owner": old["owner"], **old["spec"]}


def _interface(old: dict[str, Any]) -> dict[str, Any]:
    return _renamed(old["spec"], {"addr": "address"})


def _environment(old: dict[str, Any]) -> dict[str, Any]:
    options = dict(old["options"])
    address = options.pop("groupIp", "")
    address = options.pop("groupIP", "") or address
    if address:
        options["group_address"] = address
    return {**old, "options": _renamed(options, {"specialFeatures": "features", "env": "variables"})}


def _renamed(fields: dict[str, Any], names: dict[str, str]) -> dict[str, Any]:
    return {names.get(name, name): value for name, value in fields.items()}


CHANGES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "Node": _node,
    "Parameter": _parameter,
    "Interface": _interface,
    "Environment": _environment,
}
