"""Two Masters of which the leader fails: acknowledged means present, and no old leader acknowledges anything."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
pytest.importorskip("psycopg", reason="needs a client of PostgreSQL: pip install '.[postgresql]'")

from rce.bench.standby.database import program
from rce.bench.standby.faults import Fault
from rce.bench.standby.report import as_text
from rce.bench.standby.run import Plan, measure
from rce.errors import Unavailable
from tests.support.e2e.namespaces import network

FAULTS = (
    Fault("stop past the lease", "leader", 12.5),
    Fault("terminate", "database"),
    Fault("kill, no restart", "leader", 12.0),
)
SECONDS = 40.0

pytestmark = [pytest.mark.e2e, pytest.mark.ros]


async def test_acknowledged_commands_survive_failures_of_the_leader(tmp_path: Path) -> None:
    """As many of three faults as a busy machine manages in 40 s; `rce bench standby` does more."""
    try:
        program("initdb")
    except Unavailable as error:
        pytest.skip(str(error))
    with network("probe"):  # or the test is skipped
        pass
    result = await measure(tmp_path, Plan(1, len(FAULTS), SECONDS, robots=2, faults=FAULTS))
    print(as_text(result))
    assert result.terms >= 2
    assert result.take_overs
