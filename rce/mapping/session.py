"""Saving a mapper in a file, and going on from there."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest, NotFound
from rce.mapping.grid import OccupancyGrid
from rce.mapping.localiser import Localiser
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.mappers import MAPPERS, AnyMapper
from rce.mapping.outputs import write_atomically
from rce.mapping.scans import Scan
from rce.mapping.state import Array, Reader, flatten

FORMAT, VERSION = "rce mapping session", 1
MOST_BYTES = 4_000_000_000  # unpacked
MOST_PARTICLES = 10_000


def save_session(mapper: AnyMapper, path: Path) -> None:
    """Write all that the mapper knows to one file (.npz, no pickled objects), which appears whole or not at all."""
    kind = next(name for name, each in MAPPERS.items() if isinstance(mapper, each))
    settings = mapper.settings
    arrays = dict(flatten(mapper.state()))
    arrays["about"] = np.array([FORMAT, str(VERSION), kind])
    arrays["sizes"] = np.array([settings.resolution, settings.max_range], np.float64)
    arrays["counts"] = np.array([settings.particles, settings.seed], np.int64)
    whole = io.BytesIO()
    np.savez_compressed(whole, **arrays)  # type: ignore[arg-type]  # its stubs take the names for options
    write_atomically(path, whole.getvalue())


def resume_session(path: Path, cores: int = 0) -> AnyMapper:
    """The mapper that was saved; its next scan gives what it would have given then.

    NotFound if there is no such file; InvalidRequest if it is something else, damaged, or of another version.
    """
    arrays = _read(path)
    kind = _kind(arrays, path)
    reader = Reader(arrays)
    resolution, max_range = reader.array("sizes", np.float64, 2).tolist()
    particles, seed = reader.array("counts", np.int64, 2).tolist()
    if not (0.001 <= resolution <= 10 and 0 < max_range <= 10_000 and 0 < particles <= MOST_PARTICLES and seed >= 0):
        raise reader.wrong("sizes", "or counts are beyond all limits")
    settings = MapperSettings(resolution, max_range, particles, seed, cores)
    return MAPPERS[kind].restored(settings, reader)


class Relocating:
    """A resumed mapper whose robot has been moved meanwhile: a `Mapper` that first finds out where in its map the robot
    is (see `Localiser`), and then maps on. Until then scans are answered with `taken=False`."""

    def __init__(self, mapper: AnyMapper) -> None:
        self.mapper = mapper
        self._localiser: Localiser | None = Localiser(mapper.grid(), settings=mapper.settings)

    @property
    def lost(self) -> bool:
        return self._localiser is not None

    def add(self, scan: Scan) -> Estimate:
        if self._localiser is not None:
            found = self._localiser.add(scan)
            if not found.taken:
                return found
            self.mapper.relocate(found.pose)
            self._localiser = None
        return self.mapper.add(scan)

    def grid(self) -> OccupancyGrid:
        return self.mapper.grid()

    def trajectory(self) -> NDArray[np.float64]:
        return self.mapper.trajectory()


def _read(path: Path) -> dict[str, Array]:
    if not path.is_file():
        raise NotFound(f"no such saved session: {path}", field="file")
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > MOST_BYTES:
                raise InvalidRequest(f"{path} would take more than {MOST_BYTES:,} bytes unpacked", field="file")
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, KeyError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise InvalidRequest(
            f"{path} is not a saved mapping session, or a damaged one: {error}", field="file"
        ) from None


def _kind(arrays: dict[str, Array], path: Path) -> str:
    about = arrays.get("about")
    if about is None or about.dtype.kind != "U" or about.shape != (3,) or about[0] != FORMAT:
        raise InvalidRequest(f"{path} is not a saved mapping session", field="file")
    _, version, kind = about.tolist()
    if version != str(VERSION) or kind not in MAPPERS:
        raise InvalidRequest(
            f"{path} is a session of the mapper {kind}, version {version}; this program reads version {VERSION} of "
            f"{', '.join(MAPPERS)}",
            field="file",
        )
    return str(kind)
