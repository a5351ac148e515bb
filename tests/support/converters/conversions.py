"""Short forms of conversions for the tests of the converters."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, TypeAlias

import pytest

from converters import Codec, Wire
from rce.errors import ConversionError

CodecOf: TypeAlias = Callable[[str], Codec]


def json_wire(raw: str | bytes) -> Wire:
    """Return a payload without blobs."""
    return Wire(False, raw if isinstance(raw, bytes) else raw.encode(), {})


def round_trip(codec: Codec, value: object) -> Any:
    """Encode a message as CDR, decode it again and return its JSON."""
    raw = value if isinstance(value, str) else json.dumps(value)
    return json.loads(codec.decode(codec.encode(json_wire(raw))).raw)


def encoding_error(codec: Codec, value: object) -> ConversionError:
    """Return the error with which a codec rejects a message."""
    with pytest.raises(ConversionError) as caught:
        codec.encode(json_wire(value if isinstance(value, str | bytes) else json.dumps(value)))
    assert codec.name in str(caught.value)
    assert len(str(caught.value)) < 400
    return caught.value
