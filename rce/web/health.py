"""`/healthz` and `/readyz`, which supervisors and load balancers poll without credentials."""

from __future__ import annotations

from msgspec import Struct


class Health(Struct, frozen=True):
    """State of a server: `missing` has a sentence for each thing that it lacks to do its work."""

    status: str
    missing: list[str] = []


def health(missing: list[str]) -> tuple[Health, int]:
    """Return the answer and its HTTP status, 503 while something is missing."""
    return (Health("missing", missing), 503) if missing else (Health("ok"), 200)
