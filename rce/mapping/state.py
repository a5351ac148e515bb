"""The state of a mapper as a tree of arrays, and reading it back with checks: it may come from anywhere."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose

Array = NDArray[Any]
State = dict[str, Union[Array, "State"]]


def flatten(state: State, prefix: str = "") -> Iterator[tuple[str, Array]]:
    """The arrays by their paths in the tree, `a/b/c`."""
    for name, value in state.items():
        if isinstance(value, dict):
            yield from flatten(value, f"{prefix}{name}/")
        else:
            yield prefix + name, value


def optional(pose: Pose | None) -> NDArray[np.float64]:
    """(0, 3) or (1, 3)."""
    return np.array([] if pose is None else [pose], np.float64).reshape(-1, 3)


def pack(pieces: Sequence[Array], kind: type) -> State:
    """Arrays (n, 2) of one type and of different lengths, as one."""
    return {
        "lengths": np.array([len(piece) for piece in pieces], np.int64),
        "rows": np.concatenate([np.empty((0, 2), kind), *pieces]),
    }


class Reader:
    """The arrays of a flattened state. Whatever is asked for and is not there, of another shape, or nonsense, is an
    InvalidRequest that names it."""

    def __init__(self, arrays: Mapping[str, Array], prefix: str = "") -> None:
        self._arrays, self._prefix = arrays, prefix

    def part(self, name: str) -> Reader:
        return Reader(self._arrays, f"{self._prefix}{name}/")

    def has(self, name: str) -> bool:
        """Whether there is a part of this name."""
        return any(key.startswith(f"{self._prefix}{name}/") for key in self._arrays)

    def array(self, name: str, kind: ArrayLike | type, *shape: int | None) -> Array:
        """An array of this type and shape; None stands for any length. Floats are finite."""
        path = self._prefix + name
        found = self._arrays.get(path)
        if found is None:
            raise self.wrong(name, "is missing")
        wanted = np.dtype(kind)  # type: ignore[arg-type]
        if found.dtype != wanted or found.ndim != len(shape):
            raise self.wrong(name, f"is {found.dtype}{found.shape}, not {wanted} with {len(shape)} dimensions")
        if any(want is not None and have != want for have, want in zip(found.shape, shape, strict=True)):
            raise self.wrong(name, f"has the shape {found.shape}, not {shape}")
        if wanted.kind == "f" and not np.isfinite(found).all():
            raise self.wrong(name, "has values that are no numbers")
        return np.ascontiguousarray(found) if found.ndim else found

    def indices(self, name: str, below: int, *shape: int | None, lowest: int = 0) -> NDArray[np.int64]:
        """Integers from `lowest` to less than `below`."""
        found = self.array(name, np.int64, *shape)
        if found.size and not lowest <= found.min() <= found.max() < below:
            raise self.wrong(name, f"points outside of {lowest} to {below - 1}")
        return found

    def number(self, name: str) -> float:
        return float(self.array(name, np.float64))

    def whole(self, name: str, below: int, lowest: int = 0) -> int:
        return int(self.indices(name, below, lowest=lowest))

    def poses(self, name: str) -> list[Pose]:
        return [Pose(*row) for row in self.array(name, np.float64, None, 3).tolist()]

    def optional(self, name: str) -> Pose | None:
        """See the function `optional`."""
        found = self.poses(name)
        return found[0] if found else None

    def unpack(self, name: str, kind: type) -> list[Array]:
        """See `pack`."""
        part = self.part(name)
        rows = part.array("rows", kind, None, 2)
        lengths = part.indices("lengths", len(rows) + 1, None)
        if lengths.sum() != len(rows):
            raise part.wrong("lengths", "do not add up to all rows")
        return (
            [np.ascontiguousarray(piece) for piece in np.split(rows, np.cumsum(lengths)[:-1])] if len(lengths) else []
        )

    def wrong(self, name: str, what: str) -> InvalidRequest:
        return InvalidRequest(
            f"not a saved mapping session, or a damaged one: {self._prefix}{name} {what}", field="file"
        )
