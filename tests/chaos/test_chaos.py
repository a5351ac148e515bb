"""A platform whose processes fail at random: what it acknowledged is there, nothing is there twice, nothing is left."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rce.bench.chaos.report import as_text
from rce.bench.chaos.run import Plan, measure

EVENTS, SECONDS = 60, 100.0
SEED = int(os.environ.get("RCE_CHAOS_SEED", "1"))

pytestmark = [pytest.mark.e2e, pytest.mark.ros]


async def test_acknowledged_commands_survive_random_faults(tmp_path: Path) -> None:
    """60 faults, or as many as a busy machine manages in 100 s. RCE_CHAOS_SEED repeats another run."""
    result = await measure(tmp_path, Plan(SEED, EVENTS, SECONDS, long=False))
    print(as_text(result))
    assert result.audits
