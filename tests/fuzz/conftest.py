"""Number of cases, seed, and the attacked processes.

`pytest tests/fuzz --cases 1000000 --fuzz-seed 7` runs a million cases in place of the usual number, as root.
"""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from tests.support.fuzz.target import Target

CASES = 20_000  # in CI


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cases", type=int, default=CASES, help="cases of all ports together")
    parser.addoption("--fuzz-seed", default="1", help="seed of the cases")


@pytest.fixture(scope="session")
def seed(pytestconfig: pytest.Config) -> str:
    """Seed of the cases, to be extended by the name of the test and the number of the connection."""
    return str(pytestconfig.getoption("--fuzz-seed", "1"))


@pytest.fixture
def cases(request: pytest.FixtureRequest) -> int:
    """Number of cases of a test: its share, which the marker `share` has, of all."""
    marker = request.node.get_closest_marker("share")
    assert marker is not None
    every: int = request.config.getoption("--cases", CASES)
    return round(every * float(marker.args[0]))


@pytest.fixture(scope="session")
async def target(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> AsyncIterator[Target]:
    """Master, Robot endpoint, map service, knowledge service and a bystander, each a process."""
    long = pytestconfig.getoption("--cases", CASES) != CASES
    made = Target(tmp_path_factory.mktemp("fuzz"))
    try:
        await made.start(apart=long)
        yield made
    finally:
        await made.stop()
    for name, found in made.figures.items():
        print(f"bystander, {name}: {found.received} messages, p50 {1e3 * found.p50:.1f}, p99 {1e3 * found.p99:.1f} ms")
    print("most memory, MB:", {name: round(used / 1e6) for name, used in made.memory.items()})
