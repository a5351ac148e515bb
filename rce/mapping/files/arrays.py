"""Named arrays as one file or message: .npz without pickled objects."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from rce.errors import InvalidRequest
from rce.mapping.state import Array

MAX_BYTES = 4_000_000_000  # of the unpacked arrays


def pack_arrays(arrays: Mapping[str, Array], compress: bool = True) -> bytes:
    """Return arrays as bytes."""
    named: dict[str, Any] = dict(arrays)  # the stubs of savez take the names for options
    whole = io.BytesIO()
    (np.savez_compressed if compress else np.savez)(whole, **named)
    return whole.getvalue()


def unpack_arrays(source: Path | BinaryIO, what: str, kind: str, field: str = "") -> dict[str, Array]:
    """Return the arrays of a file or message.

    Args:
        source: The file or message.
        what: Its name in errors.
        kind: What it should be, for errors: `a saved mapping session`.
        field: Field of errors.

    Raises:
        InvalidRequest: They are not arrays, are damaged, or would take too much memory.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
                raise InvalidRequest(f"{what} would take more than {MAX_BYTES:,} bytes when unpacked", field=field)
        with np.load(source, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, KeyError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise InvalidRequest(f"{what} is not {kind}, or a damaged one: {error}", field=field) from None
