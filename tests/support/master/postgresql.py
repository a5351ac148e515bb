"""The PostgreSQL of the tests."""

from __future__ import annotations

import os

import pytest

POSTGRES = os.environ.get("RCE_TEST_POSTGRES", "")
needs_postgres = pytest.mark.skipif(
    not POSTGRES, reason="set RCE_TEST_POSTGRES to the SQLAlchemy URL of a PostgreSQL database for tests"
)
