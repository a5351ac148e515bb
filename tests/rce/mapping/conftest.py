"""Fixtures of the tests of mapping."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.mapping.evaluation.simulation import Simulation, simulate
from tests.support.paths import DATA


@pytest.fixture(scope="session")
def simulation() -> Simulation:
    return simulate()


@pytest.fixture(scope="session")
def data() -> Path:
    """Directory of recorded data; tests that need it are skipped without it."""
    if not DATA.is_dir():
        pytest.skip(f"no recorded data in {DATA}; set RCE_DATA to use another directory")
    return DATA
