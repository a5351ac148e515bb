"""The only layer of an image with a program that stands in for the endpoint (stand_in.c)."""

from __future__ import annotations

import io
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

from tests.support.paths import TESTS


def stand_in_layer(directory: Path) -> bytes:
    """Compile the program in a directory; skip the test where there is no compiler."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler for the stand-in's program: install g++ to run this")
    program = directory / "stand-in"
    source = TESTS / "support" / "containers" / "stand_in.c"
    subprocess.run(["gcc", "-static", "-Os", "-s", "-o", str(program), str(source)], check=True)
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        tar.add(program, "stand-in")
    return archive.getvalue()
