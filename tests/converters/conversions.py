"""Conversions of the tests in a few words."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, TypeAlias

import pytest

from converters import Codec, Wire
from rce.errors import ConversionError

CodecOf: TypeAlias = Callable[[str], Codec]


def text(raw: str | bytes) -> Wire:
    return Wire(False, raw if isinstance(raw, bytes) else raw.encode(), {})


def back(codec: Codec, value: object) -> Any:
    """Through CDR and back."""
    raw = value if isinstance(value, str) else json.dumps(value)
    return json.loads(codec.decode(codec.encode(text(raw))).raw)


def refused(codec: Codec, value: object) -> ConversionError:
    with pytest.raises(ConversionError) as caught:
        codec.encode(text(value if isinstance(value, str | bytes) else json.dumps(value)))
    assert codec.name in str(caught.value)
    assert len(str(caught.value)) < 400
    return caught.value
