"""Simulated machines of `rce.bench.network.bridge`, for tests."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from rce.bench.network.bridge import Network
from rce.bench.network.namespaces import IP
from rce.errors import Unavailable


@contextmanager
def network(*names: str) -> Iterator[Network]:
    """Make a network with these machines, or skip the test where that is not possible."""
    if os.geteuid() != 0 or shutil.which(IP) is None:
        pytest.skip("network namespaces need root and iproute2: run the tests as root")
    network = Network(names)
    try:
        try:
            network.make()
        except Unavailable as error:
            pytest.skip(f"no network namespaces here: {error}")
        yield network
    finally:
        network.remove()
