"""Mutations of structures and bytes: seeded, repeatable, and fast (20 to 40 thousand cases a second).

Hypothesis generates some hundred cases a second; here, the templates are valid messages of the protocol, and a case
differs from one in a few places. So most cases pass the first checks and reach the code behind them.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

T = TypeVar("T")
NUMBERS = (0, -1, 1, 2, 127, 128, 255, 256, 2**15, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63, -(2**63) - 1)
FLOATS = (0.5, -0.0, 1e308, -1e-320, float("nan"), float("inf"), float("-inf"), 1e23)
TEXTS = (
    "", " ", "\0", "a" * 256, "x" * 2000, "\ud800", "\u202e\u2028", "é" * 300, "😀", "%s{}$(env X)", "../../etc",
    "@guest", "a/b", "/", "*", "msg*", "0" * 32, "f" * 32, "NaN", "Infinity", "-1", "true", "null", "std_msgs/String",
    "sensor_msgs/Image", "std_msgs/msg/Header", "nil", "1e999", "<x>&amp;", "\r\n", "'; --",
)  # fmt: skip
SPECIAL: tuple[Any, ...] = (None, True, False, [], {}, [[]], [{}], {"": ""}, {"msg*": "0" * 32}, {"a*": ["0" * 32]})
RAW = {
    "<deep list>": b"[" * 1500,
    "<deep object>": b'{"a":' * 1500,
    "<long number>": b"9" * 500,
    "<exponent>": b"1e99999999",
    "<token>": b"NaN",
    "<doubled key>": b'1,"data":{},"type":"DM"',
    "<bad escape>": b'"\\uD800\\x"',
    "<bad utf8>": b'"\xff\xfe\xc0"',
}
"""Texts that stand for what a JSON encoder does not write."""
LARGE = ("x" * 70_000, "é" * 300_000, [0] * 50_000, {str(number): number for number in range(5000)})
LARGE_SHARE = 0.002
_POOLS: tuple[Sequence[Any], ...] = (NUMBERS, FLOATS, TEXTS, TEXTS, SPECIAL, tuple(RAW))
_WORDS = tuple(
    number.to_bytes(size, order)
    for size in (1, 2, 4, 8)
    for number in (0, 1, 2 ** (8 * size - 1), 2 ** (8 * size) - 1, 2 ** (8 * size) - 2)
    for order in ("big", "little")
)  # type: ignore[call-overload, unused-ignore]


class Mutator:
    """Source of mutations; the same seed gives the same cases."""

    def __init__(self, seed: int | str) -> None:
        self.random = random.Random(seed)

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def choose(self, values: Sequence[T]) -> T:
        return values[int(self.random.random() * len(values))]

    def value(self) -> Any:
        """Return an unusual value."""
        return _copy(self.choose(LARGE if self.chance(LARGE_SHARE) else self.choose(_POOLS)))

    def structure(self, value: Any, most: int = 3) -> Any:
        """Return a copy of a value of lists and dicts with one to `most` mutations."""
        root = [_copy(value)]
        for _ in range(1 + int(self.random.random() * most)):
            places = _places(root)
            container, key = self.choose(places)
            self.choose(_CHANGES)(self, container, key, places)
        return root[0] if root else None

    def json(self, value: Any, most: int = 3) -> bytes:
        """Return the JSON of a mutated value; at times it is damaged further."""
        text = encode(self.structure(value, most))
        return self.damage(text) if self.chance(0.1) else text

    def damage(self, data: bytes, most: int = 4) -> bytes:
        """Return mutated bytes."""
        changed = bytearray(data)
        for _ in range(1 + int(self.random.random() * most)):
            self.choose(_DAMAGES)(self, changed)
        return bytes(changed)

    def noise(self, most: int) -> bytes:
        """Return up to `most` random bytes."""
        return self.random.randbytes(int(self.random.random() * (most + 1)))

    def pieces(self, data: bytes, most: int = 6) -> list[bytes]:
        """Cut bytes into up to `most` pieces, of which some may be empty."""
        cuts = sorted(int(self.random.random() * (len(data) + 1)) for _ in range(int(self.random.random() * most)))
        return [data[start:end] for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def encode(value: Any) -> bytes:
    """Return JSON, with the tokens of Python's encoder and what the texts of RAW stand for."""
    text = json.dumps(value).encode()
    for mark, raw in RAW.items():
        text = text.replace(b'"' + mark.encode() + b'"', raw)
    return text


def _copy(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copy(each) for key, each in value.items()}
    return [_copy(each) for each in value] if isinstance(value, list) else value


def _places(root: list[Any]) -> list[tuple[Any, Any]]:
    """Return container and key of each value in a structure."""
    found: list[tuple[Any, Any]] = []
    rest: list[Any] = [root]
    while rest:
        container = rest.pop()
        for key, value in container.items() if isinstance(container, dict) else enumerate(container):
            found.append((container, key))
            if isinstance(value, dict | list):
                rest.append(value)
    return found


Place = tuple[Any, Any]


def _replace(mutator: Mutator, container: Any, key: Any, _: list[Place]) -> None:
    container[key] = mutator.value()


def _remove(mutator: Mutator, container: Any, key: Any, places: list[Place]) -> None:
    if isinstance(container, dict):
        container.pop(key, None)
    else:
        _replace(mutator, container, key, places)


def _rename(mutator: Mutator, container: Any, key: Any, _: list[Place]) -> None:
    if isinstance(container, dict) and key in container:
        container[mutator.choose(TEXTS)] = container.pop(key)


def _add(mutator: Mutator, container: Any, _key: Any, _: list[Place]) -> None:
    if isinstance(container, dict):
        container[mutator.choose(TEXTS)] = mutator.value()
    elif len(container) > 1:  # the root list must have one item
        container.append(mutator.value())


def _wrap(mutator: Mutator, container: Any, key: Any, _: list[Place]) -> None:
    if isinstance(container, list) or key in container:
        container[key] = [container[key]] if mutator.chance(0.5) else {"data": container[key]}


def _repeat(mutator: Mutator, container: Any, key: Any, _: list[Place]) -> None:
    value = container[key] if isinstance(container, list) else container.get(key)
    times = mutator.choose((2, 3, 50)) if mutator.chance(0.98) else 1000
    container[key] = [_copy(value) for _ in range(times)]


def _move(mutator: Mutator, container: Any, key: Any, places: list[Place]) -> None:
    other, name = mutator.choose(places)
    if isinstance(other, list) or name in other:
        container[key] = _copy(other[name])


def _flip(mutator: Mutator, container: Any, key: Any, _: list[Place]) -> None:
    """Change the type of a value, or a part of a text."""
    value = container[key] if isinstance(container, list) else container.get(key)
    if isinstance(value, str) and value and mutator.chance(0.7):
        cut = int(mutator.random.random() * len(value))
        container[key] = value[:cut] + mutator.choose(TEXTS)[:300] + value[cut + 1 :]
    elif isinstance(value, bool | int | float):
        container[key] = str(value)
    else:
        container[key] = str(value)[:50]


_CHANGES: tuple[Callable[[Mutator, Any, Any, list[Place]], None], ...] = (
    *(_replace, _replace, _replace, _remove, _rename, _add, _wrap, _repeat, _move, _flip),
)


def _set_bytes(mutator: Mutator, data: bytearray) -> None:
    for _ in range(1 + int(mutator.random.random() * 4)):
        if data:
            data[int(mutator.random.random() * len(data))] = int(mutator.random.random() * 256)


def _set_word(mutator: Mutator, data: bytearray) -> None:
    """Write a boundary value, most often near the begin, where the lengths are."""
    word = mutator.choose(_WORDS)
    place = int(mutator.random.random() ** 2 * (len(data) + 1))
    data[place : place + len(word)] = word


def _cut(mutator: Mutator, data: bytearray) -> None:
    del data[int(mutator.random.random() * (len(data) + 1)) :]


def _drop(mutator: Mutator, data: bytearray) -> None:
    start = int(mutator.random.random() * (len(data) + 1))
    del data[start : start + int(mutator.random.random() * 32)]


def _insert(mutator: Mutator, data: bytearray) -> None:
    start = int(mutator.random.random() * (len(data) + 1))
    data[start:start] = mutator.noise(16)


def _double(mutator: Mutator, data: bytearray) -> None:
    start = int(mutator.random.random() * (len(data) + 1))
    end = start + int(mutator.random.random() * 64)
    data[end:end] = data[start:end] * mutator.choose((1, 1, 2, 20))


_DAMAGES: tuple[Callable[[Mutator, bytearray], None], ...] = (_set_bytes, _set_word, _cut, _drop, _insert, _double)
