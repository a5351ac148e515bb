"""API keys over HTTP: made by their users, and used."""

from __future__ import annotations

from typing import Any

from tests.support.master.served import Answer, Served


async def make_key(served: Served, user: str = "ann", **wanted: Any) -> tuple[str, str]:
    """Return the id and the secret of a key that a user makes."""
    made = await served.ask("POST", "/keys", user, wanted)
    assert made.status == 201, made.body
    return made.body["key"]["id"], made.body["secret"]


async def ask_by_key(served: Served, secret: str, method: str, path: str, body: Any = None) -> Answer:
    """Make a request with an API key."""
    return await served.ask(method, path, "", body, Authorization=f"Bearer {secret}")
