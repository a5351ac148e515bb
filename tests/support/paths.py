"""Paths of files that the tests use."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
ROS_PACKAGES = TESTS / "ros"
TEST_PACKAGE = ROS_PACKAGES / "Test"
"""Packages whose types `provision test` builds with those of RCE, once for all tests."""
DATA = Path(os.environ.get("RCE_DATA", ROOT.parent / "shared" / "data"))
"""Recorded data; tests that need it are skipped where it is absent."""
