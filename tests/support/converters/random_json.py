"""Random JSON for any message type, from a seeded generator."""

from __future__ import annotations

import base64
import random
import struct
from typing import TypeAlias

from converters.definition import BYTES, CODES, FieldType, Shape
from converters.model import Message
from converters.scalars import RANGES

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json]"

TEXTS = ("", "a", "map", "Grüße", "機器人", 'a\n"b"\\', "x" * 37)
FLOATS = (0.0, -1.5, 1e-3, 3.25e7, "NaN", "Infinity", "-Infinity")


def sample(message: Message, rng: random.Random) -> dict[str, Json]:
    """Return a message with a value for every field; floats are exact in float32."""
    return {m.field.name: _field(m.type, m.message, rng) for m in message.members}


def _field(kind: FieldType, nested: Message | None, rng: random.Random) -> Json:
    if kind.shape is Shape.SINGLE:
        return _one(kind, nested, rng)
    count = kind.size if kind.shape is Shape.ARRAY else rng.randint(0, min(kind.size or 4, 4))
    if kind.base in BYTES:
        return base64.b64encode(rng.randbytes(count)).decode()
    return [_one(kind, nested, rng) for _ in range(count)]


def _one(kind: FieldType, nested: Message | None, rng: random.Random) -> Json:
    if nested:
        return sample(nested, rng)
    if kind.base not in CODES:
        return rng.choice(TEXTS)[: kind.text_bound or None]
    code = CODES[kind.base]
    if code == "?":
        return rng.random() < 0.5
    if code in "fd":
        value = rng.choice(FLOATS)
        return value if isinstance(value, str) else float(struct.unpack("<f", struct.pack("<f", value))[0])
    low, high = RANGES[code]
    return rng.choice((low, high, rng.randint(low, high)))
