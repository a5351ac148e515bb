"""State of a mapper as a tree of arrays, and a reader that validates it: a saved file may come from anywhere."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Union

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose

Array = NDArray[Any]
State = dict[str, Union[Array, "State"]]


def flatten(state: State, prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield the arrays of a state with their paths in the tree, `a/b/c`."""
    for name, value in state.items():
        if isinstance(value, dict):
            yield from flatten(value, f"{prefix}{name}/")
        else:
            yield prefix + name, value


def optional(pose: Pose | None) -> NDArray[np.float64]:
    """Return a pose as an array (1, 3), or (0, 3) for None."""
    return np.array([] if pose is None else [pose], np.float64).reshape(-1, 3)


def pack(pieces: Sequence[Array], kind: type) -> State:
    """Return arrays (n, 2) of one type and different lengths as one array with the lengths."""
    return {
        "lengths": np.array([len(piece) for piece in pieces], np.int64),
        "rows": np.concatenate([np.empty((0, 2), kind), *pieces]),
    }


class Reader:
    """Validating reader of a flattened state.

    All methods raise InvalidRequest, which names the array, if it is missing, has another shape or type, or makes no
    sense.
    """

    def __init__(self, arrays: Mapping[str, Array], prefix: str = "") -> None:
        """Read the arrays whose paths begin with `prefix`."""
        self._arrays, self._prefix = arrays, prefix

    def part(self, name: str) -> Reader:
        """Return a reader of a branch of the tree."""
        return Reader(self._arrays, f"{self._prefix}{name}/")

    def has(self, name: str) -> bool:
        """Return whether there is a branch of this name."""
        return any(key.startswith(f"{self._prefix}{name}/") for key in self._arrays)

    def array(self, name: str, kind: DTypeLike, *shape: int | None) -> Array:
        """Return an array of this type and shape, where None stands for any length. Floats are finite."""
        path = self._prefix + name
        found = self._arrays.get(path)
        if found is None:
            raise self.invalid(name, "is missing")
        wanted = np.dtype(kind)
        if found.dtype != wanted or found.ndim != len(shape):
            raise self.invalid(name, f"is {found.dtype}{found.shape}, not {wanted} with {len(shape)} dimensions")
        if any(want is not None and have != want for have, want in zip(found.shape, shape, strict=True)):
            raise self.invalid(name, f"has the shape {found.shape}, not {shape}")
        if wanted.kind == "f" and not np.isfinite(found).all():
            raise self.invalid(name, "has values that are not finite")
        return np.ascontiguousarray(found) if found.ndim else found

    def indices(self, name: str, below: int, *shape: int | None, lowest: int = 0) -> NDArray[np.int64]:
        """Return an array of integers from `lowest` to less than `below`."""
        found = self.array(name, np.int64, *shape)
        if found.size and not lowest <= found.min() <= found.max() < below:
            raise self.invalid(name, f"has values outside of {lowest} to {below - 1}")
        return found

    def number(self, name: str) -> float:
        """Return a floating-point number."""
        return float(self.array(name, np.float64))

    def whole(self, name: str, below: int, lowest: int = 0) -> int:
        """Return an integer from `lowest` to less than `below`."""
        return int(self.indices(name, below, lowest=lowest))

    def poses(self, name: str) -> list[Pose]:
        """Return the poses of an array (n, 3)."""
        return [Pose(*row) for row in self.array(name, np.float64, None, 3).tolist()]

    def optional(self, name: str) -> Pose | None:
        """Return the pose that the function `optional` has stored, or None."""
        found = self.poses(name)
        return found[0] if found else None

    def unpack(self, name: str, kind: type) -> list[Array]:
        """Return the arrays that `pack` has stored."""
        part = self.part(name)
        rows = part.array("rows", kind, None, 2)
        lengths = part.indices("lengths", len(rows) + 1, None)
        if lengths.sum() != len(rows):
            raise part.invalid("lengths", "do not add up to the number of rows")
        return (
            [np.ascontiguousarray(piece) for piece in np.split(rows, np.cumsum(lengths)[:-1])] if len(lengths) else []
        )

    def invalid(self, name: str, reason: str) -> InvalidRequest:
        """Return the error for an array, to be raised."""
        return InvalidRequest(
            f"not a saved mapping session, or a damaged one: {self._prefix}{name} {reason}", field="file"
        )
