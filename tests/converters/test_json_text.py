"""JSON with the bare tokens NaN, Infinity and -Infinity."""

from __future__ import annotations

import msgspec
import pytest

from converters.json_text import decode
from converters.scalars import FieldError


class Model(msgspec.Struct):
    text: str = ""
    number: float | str = 0.0
    inner: list[float] = []


DECODER = msgspec.json.Decoder(Model)


def test_tokens_become_marked_strings() -> None:
    assert decode(DECODER, b'{"number": -Infinity}').number == "\0-Infinity"


def test_tokens_in_strings_are_kept() -> None:
    model = decode(DECODER, b'{"text": "NaN \\"Infinity", "number": NaN}')
    assert (model.text, model.number) == ('NaN "Infinity', "\0NaN")


@pytest.mark.parametrize(
    ("raw", "path"),
    [(b'{"inner": [1, "x"]}', "inner[1]"), (b'{"text": 5}', "text"), (b'{"text": 5, "number": NaN}', "text")],
)
def test_error_has_the_path_of_the_field(raw: bytes, path: str) -> None:
    with pytest.raises(FieldError) as caught:
        decode(DECODER, raw)
    assert caught.value.path == path
