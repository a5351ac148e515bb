"""Fixtures of the tests of ROS 2 nodes.

Modules of `rce_mapping` that use types which the ROS 2 wheels lack are imported within tests, after `start_ros` or
`interfaces` has made these types available.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

from rce.mapping.evaluation.simulation import Simulation, simulate
from tests.support.domains import domain
from tests.support.paths import ROOT, TEST_PACKAGE

NODES = ROOT / "containers" / "nodes"
LIBRARIES = ("rce_mapping", "rce_mapping3d", "rce_planning", "rce_localisation", "rce_knowledge", "rce_recognition")
sys.path[:0] = [str(NODES / name) for name in LIBRARIES]


@pytest.fixture(scope="session")
def simulation() -> Simulation:
    return simulate()


@pytest.fixture(scope="session")
def interfaces() -> None:
    """Make the types of RCE's interface packages importable."""
    from provisioning import typesupport

    sys.path.insert(0, str(typesupport.build([*typesupport.shipped(), TEST_PACKAGE]).prefix / "python"))


@pytest.fixture
def start_ros(monkeypatch: pytest.MonkeyPatch, interfaces: None) -> Iterator[Callable[..., None]]:
    """`start_ros("name:=value")` starts rclpy in a domain of these tests, with parameters for the nodes."""
    import rclpy

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

    def start(*parameters: str) -> None:
        words = [word for each in parameters for word in ("-p", each)]
        rclpy.init(args=["--ros-args", *words], domain_id=domain("nodes"))

    yield start
    rclpy.try_shutdown()


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str], ModuleType]]:
    """`load("rce_bench", "echo")` imports a program of a package, and its neighbours as the program finds them."""
    before = set(sys.modules)

    def load(package: str, name: str) -> ModuleType:
        monkeypatch.syspath_prepend(NODES / package)
        return importlib.import_module(name)

    yield load
    for name in set(sys.modules) - before:
        file = getattr(sys.modules[name], "__file__", None)
        if file and Path(file).parent.parent == NODES:  # their names are too common to be kept
            del sys.modules[name]
