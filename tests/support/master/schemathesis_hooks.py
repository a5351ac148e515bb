"""Hooks of schemathesis: rules of the API that its OpenAPI document cannot express."""

from __future__ import annotations

from typing import Any

import schemathesis


@schemathesis.hook
def before_call(context: schemathesis.HookContext, case: schemathesis.Case[Any], *args: Any) -> None:
    """Ask for no endless streams, write integers without a point, restrict only keys of robots, and start programs."""
    if case.query:
        case.query.pop("follow", None)
    case.body = _written(case.body)
    if case.operation.label == "POST /api/v1/keys" and isinstance(case.body, dict):
        scopes = case.body.get("scopes")
        if case.body.get("role") != "robot" and isinstance(scopes, dict) and _is_good(scopes):
            del case.body["scopes"]
    if case.operation.label == "POST /api/v1/environments/{environment}/nodes" and isinstance(case.body, dict):
        if case.body.get("exe", "") == case.body.get("launch", "") == "":
            case.body["exe"] = "a"  # one of both is needed
        elif case.body.get("exe") and isinstance(case.body["exe"], str) and isinstance(case.body.get("launch"), str):
            del case.body["launch"]


@schemathesis.serializer("application/offset+octet-stream")
def pieces_of_uploads(context: schemathesis.SerializationContext, value: Any) -> bytes:
    """Return the bytes of a piece of an upload (tus 1.0)."""
    return bytes(value) if isinstance(value, bytes) else str(value).encode(errors="replace")


def _written(value: Any) -> Any:
    match value:
        case float() if value.is_integer():
            return int(value)
        case dict():
            return {name: _written(each) for name, each in value.items()}
        case list():
            return [_written(each) for each in value]
    return value


def _is_good(scopes: dict[str, Any]) -> bool:
    robot, environments = scopes.get("robot", ""), scopes.get("environments", [])
    metrics = scopes.get("metrics", False)
    known = scopes.keys() <= {"robot", "environments", "metrics"} and isinstance(metrics, bool)
    return (
        known
        and isinstance(robot, str)
        and isinstance(environments, list)
        and len(environments) <= 1000
        and all(isinstance(each, str) for each in environments)
    )
