"""The program that applies limits to an environment of a swarm; test_resources.py runs it on a real one."""

from __future__ import annotations

import errno
import os
import subprocess

import msgspec
import pytest

from containers.agents.outside_limits import LimitRequest
from containers.swarm import privileged
from containers.swarm.privileged import main
from rce.errors import ErrorInfo, InvalidRequest


@pytest.fixture(autouse=True)
def variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RCE_LIMITS", msgspec.json.encode(LimitRequest(os.getpid(), "/images", bandwidth=7)).decode())


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (InvalidRequest("no tc", field="containerData.bandwidth"), ("invalid_request", "no tc")),
        (OSError(errno.ENOSPC, "No space left on device"), ("start_failed", "[Errno 28] No space left on device")),
        (subprocess.CalledProcessError(32, "mount"), ("start_failed", "Command 'mount' returned non-zero")),
    ],
)
def test_error_is_printed_on_the_last_line(
    error: Exception, expected: tuple[str, str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail(request: LimitRequest) -> None:
        raise error

    monkeypatch.setattr(privileged, "apply", fail)
    assert main() == 1
    info = msgspec.json.decode(capfd.readouterr().out.splitlines()[-1], type=ErrorInfo)
    assert info.code == expected[0]
    assert info.message.startswith(expected[1])


def test_applied_limits_print_nothing(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    applied: list[LimitRequest] = []
    monkeypatch.setattr(privileged, "apply", applied.append)
    assert main() == 0
    assert capfd.readouterr().out == ""
    assert [each.bandwidth for each in applied] == [7]
