"""Saved sessions: writing the state of a mapper to a file, and continuing from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest, NotFound
from rce.mapping.files.arrays import pack_arrays, unpack_arrays
from rce.mapping.files.outputs import write_atomically
from rce.mapping.grid import OccupancyGrid
from rce.mapping.localiser import Localiser
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.mappers import MAPPERS, AnyMapper
from rce.mapping.scans import Scan
from rce.mapping.state import Array, Reader, flatten

FORMAT, VERSION = "rce mapping session", 4
MAX_PARTICLES = 10_000


def save_session(mapper: AnyMapper, path: Path) -> None:
    """Write the state of a mapper atomically to one file: .npz without pickled objects."""
    kind = next(name for name, each in MAPPERS.items() if isinstance(mapper, each))
    settings = mapper.settings
    arrays = dict(flatten(mapper.state()))
    arrays["about"] = np.array([FORMAT, str(VERSION), kind])
    arrays["sizes"] = np.array([settings.resolution, settings.max_range], np.float64)
    arrays["counts"] = np.array([settings.particles, settings.seed], np.int64)
    write_atomically(path, pack_arrays(arrays))


def resume_session(path: Path, cores: int = 0) -> AnyMapper:
    """Return a saved mapper, which continues exactly as it would have done.

    Args:
        path: The file.
        cores: Cores over which particles are spread, 0 for all.

    Raises:
        NotFound: The file does not exist.
        InvalidRequest: The file is not a saved session, is damaged, or of another version.
    """
    arrays = _read(path)
    kind = _kind(arrays, path)
    reader = Reader(arrays)
    resolution, max_range = reader.array("sizes", np.float64, 2).tolist()
    particles, seed = reader.array("counts", np.int64, 2).tolist()
    if not (0.001 <= resolution <= 10 and 0 < max_range <= 10_000 and 0 < particles <= MAX_PARTICLES and seed >= 0):
        raise reader.invalid("sizes", "or counts are out of range")
    settings = MapperSettings(resolution, max_range, particles, seed, cores)
    return MAPPERS[kind].restored(settings, reader)


class Relocating:
    """Resumed mapper whose robot was moved meanwhile.

    It is a `Mapper` that first finds the robot in the map (see `Localiser`) and then continues to map. Until then scans
    are answered with `accepted=False`.

    Attributes:
        mapper: The resumed mapper.
    """

    def __init__(self, mapper: AnyMapper) -> None:
        """Search the robot in the current map of a mapper."""
        self.mapper = mapper
        self._localiser: Localiser | None = Localiser(mapper.grid(), settings=mapper.settings)

    @property
    def lost(self) -> bool:
        """True if the pose of the robot is unknown."""
        return self._localiser is not None

    def add(self, scan: Scan) -> Estimate:
        """Localise or map the next scan."""
        if self._localiser is not None:
            found = self._localiser.add(scan)
            if not found.accepted:
                return found
            self.mapper.relocate(found.pose)
            self._localiser = None
        return self.mapper.add(scan)

    def grid(self) -> OccupancyGrid:
        """Return the current map."""
        return self.mapper.grid()

    def trajectory(self) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of every accepted scan, map frame."""
        return self.mapper.trajectory()


def _read(path: Path) -> dict[str, Array]:
    if not path.is_file():
        raise NotFound(f"no such saved session: {path}", field="file")
    return unpack_arrays(path, str(path), "a saved mapping session", field="file")


def _kind(arrays: dict[str, Array], path: Path) -> str:
    """Return the name of the mapper of a session after checking format and version."""
    about = arrays.get("about")
    if about is None or about.dtype.kind != "U" or about.shape != (3,) or about[0] != FORMAT:
        raise InvalidRequest(f"{path} is not a saved mapping session", field="file")
    _, version, kind = about.tolist()
    if version != str(VERSION) or kind not in MAPPERS:
        raise InvalidRequest(
            f"{path} is a session of the mapper {kind}, version {version}; this program supports version {VERSION} of "
            f"{', '.join(MAPPERS)}",
            field="file",
        )
    return str(kind)
