"""Parts of a run; tests/chaos has a whole one."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rce.bench.chaos import run
from rce.bench.chaos.faults import LONG_STOP, Fault
from rce.bench.chaos.flows import Flow
from rce.bench.chaos.run import Plan, Robots, Run, measure
from rce.bench.chaos.violations import Violation

HOME, AWAY, BETWEEN = Flow("r0 to r0_home and back"), Flow("r1 to r1_home and back"), Flow("r0 to r1")
ROBOTS = Robots([], [HOME, AWAY, BETWEEN], {"r0_home": HOME, "r1_home": AWAY})


@pytest.mark.parametrize(
    ("fault", "flows"),
    [
        (Fault("kill", "master", 0), []),
        (Fault("kill", "container", 0), []),
        (Fault("kill", "robot-1", 0), ROBOTS.flows),
        (Fault("kill", "environment r0_home", 0), [HOME]),
        (Fault("kill", "node of r1_home", 0), [AWAY]),
        (Fault("stop", "robot-1", 1.0), []),
        (Fault("stop", "robot-1", LONG_STOP), ROBOTS.flows),
        (Fault("disk", "robot-1", 1.0), []),
    ],
)
def test_only_flows_through_a_lost_process_may_lose_messages(fault: Fault, flows: list[Flow]) -> None:
    assert run._may_lose(fault, ROBOTS) == flows


async def test_failure_has_seed_history_and_logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @asynccontextmanager
    async def running(directory: Path) -> AsyncIterator[Any]:
        (directory / "log").write_text('{"level":"info","message":"a"}\n{"level":"error","message":"b"}\n')
        yield None

    async def fail(self: Run) -> None:
        self._history.add("nemesis", "master killed")
        raise ExceptionGroup("", [Violation("missing: node e n")])

    monkeypatch.setattr(run, "running", running)
    monkeypatch.setattr(Run, "measure", fail)
    with pytest.raises(Violation) as failed:
        await measure(tmp_path, Plan(seed=7, events=1, seconds=1))
    lines = str(failed.value).splitlines()
    assert lines[0] == "Violation: missing: node e n"
    assert lines[1].startswith("seed 7, last entries of ")
    assert lines[2].endswith("master killed: begins")
    assert lines[-1] == '{"level":"error","message":"b"}'
