"""Dialects of messages: the forms in which the values of one type are written."""

from __future__ import annotations

from typing import Literal, TypeAlias

Dialect: TypeAlias = Literal["plain", "original", "rosbridge", "cbor"]
"""`plain`: JSON as the protocol of this platform has it; see the modules `original`, `rosbridge` and `cbor`."""
