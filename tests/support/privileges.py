"""Skips of tests that need privileges."""

from __future__ import annotations

import os

import pytest


def skip_without_mounts() -> None:
    """Skip a test that mounts file systems, unless root runs it."""
    if os.geteuid() != 0:
        pytest.skip("file systems in memory need root: run the tests as root")
