"""What the tests of mapping share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rce.mapping.simulation import Simulation, simulate


@pytest.fixture(scope="session")
def simulation() -> Simulation:
    return simulate()


@pytest.fixture(scope="session")
def data() -> Path:
    """The directory of recorded data; tests that need it are skipped where it is not."""
    beside = Path(__file__).parents[3] / "shared" / "data"
    directory = Path(os.environ.get("RCE_DATA", beside))
    if not directory.is_dir():
        pytest.skip(f"no recorded data in {directory}; RCE_DATA names another directory")
    return directory
