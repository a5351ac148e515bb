"""Further processes of a Robot endpoint: their command lines, their tokens, and who starts them again."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from endpoints.robot import siblings
from endpoints.robot.__main__ import Settings
from endpoints.robot.siblings import Siblings, sibling_arguments
from rce.control.calls.joining import InviteSibling, JoinToken
from rce.errors import Unavailable
from rce.process import programs
from rce.process.settings import load
from tests.support.e2e.real_platform import until

# A program that records its number and token, is ready at once, and runs until it is terminated.
PROGRAM = """
import json, os, signal, sys
number, file = sys.argv[1:3]
with open(file, "a") as record:
    record.write(f"{number} {os.environ['RCE_TOKEN']}\\n")
print(json.dumps({"program": "robot", "url": "ws://:1/", "control": ""}), flush=True)
signal.pause()
"""


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(programs, "command", lambda name: [sys.executable, "-c", PROGRAM])
    monkeypatch.setattr(siblings, "PAUSE", 0.0)
    return tmp_path / "record"


def recorded(record: Path) -> list[str]:
    return sorted(record.read_text().splitlines()) if record.exists() else []


def test_command_line_differs_in_what_two_processes_cannot_share() -> None:
    given = ["--name=west", "--data-dir=/d", "--ws-port=0", "--data-port=9020", "--processes=3", "--grace=5"]
    made = load(Settings, "rce robot", sibling_arguments(given, "west", Path("/d"), 9010, 9020, 3), {})
    assert (made.name, made.data_dir, made.ws_port, made.data_port) == ("west.3", Path("/d/3"), 9010, 9022)
    assert (made.processes, made.share_port, made.grace) == (1, True, 5)


def test_any_free_data_port_stays_any_free_one() -> None:
    made = load(Settings, "rce robot", sibling_arguments(["--data-dir=/d"], "west", Path("/d"), 9010, 0, 2), {})
    assert made.data_port == 0


async def test_processes_run_until_cancelled_and_those_that_never_joined_get_a_token(
    record: Path, tmp_path: Path
) -> None:
    (tmp_path / "3").mkdir()
    (tmp_path / "3" / "credential").write_text("c")
    refused = [Unavailable("the Master is away")]

    async def invite(call: InviteSibling) -> JoinToken:
        if refused:
            raise refused.pop()
        return JoinToken(f"west.{call.number}", f"token-{call.number}")

    further = Siblings(3, tmp_path, lambda number: [str(number), str(record)], sys.stderr)
    running = asyncio.create_task(further.run(invite))
    await until(lambda: recorded(record) == ["2 token-2", "3 "])
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running


async def test_one_process_has_no_further_ones(tmp_path: Path) -> None:
    async def invite(call: InviteSibling) -> JoinToken:
        raise AssertionError(call)

    await Siblings(1, tmp_path, lambda number: [], sys.stderr).run(invite)
