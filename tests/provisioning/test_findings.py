"""Judgement of findings."""

from __future__ import annotations

import pytest

from provisioning import (
    findings,
)
from provisioning.findings import DAY, GB, worst

INFO: dict[str, object] = {
    "ServerVersion": "20.10.24+dfsg1",
    "MemoryLimit": True,
    "SwapLimit": True,
    "PidsLimit": True,
    "CpuCfsQuota": True,
    "SecurityOptions": ["name=apparmor", "name=seccomp,profile=default"],
}


@pytest.mark.parametrize(("days", "level"), [(100, "ok"), (31, "ok"), (29, "warn"), (0, "bad"), (-3, "bad")])
def test_expiry_of_certificates(days: float, level: str) -> None:
    assert findings.expiry("cert.pem", days * DAY, "renew").level == level


@pytest.mark.parametrize(("seconds", "level"), [(0, "ok"), (-4, "ok"), (20, "warn"), (-4000, "bad")])
def test_clocks(seconds: float, level: str) -> None:
    finding = findings.clock(seconds)
    assert finding.level == level
    assert ("behind" in finding.found) == (seconds <= 0)


@pytest.mark.parametrize(("size", "level"), [(20, "ok"), (5, "warn"), (0.5, "bad")])
def test_amounts(size: float, level: str) -> None:
    assert findings.amount("disk", "free", size * GB, 10 * GB, 1 * GB, "free space").level == level


@pytest.mark.parametrize(("most", "level"), [(4_194_304, "ok"), (212_992, "warn")])
def test_receive_buffers(most: int, level: str) -> None:
    assert findings.receive_buffer(most).level == level


def test_suitable_docker() -> None:
    assert worst(findings.docker(INFO)) == "ok"


@pytest.mark.parametrize(
    ("change", "level", "words"),
    [
        ({"ServerVersion": "19.03.1"}, "bad", "20.10 or later"),
        ({"SwapLimit": False}, "warn", "of swap are not enforced"),
        ({"PidsLimit": False, "SwapLimit": False}, "bad", "of swap, processes are not"),
        ({"SecurityOptions": []}, "bad", "seccomp"),
    ],
)
def test_unsuitable_docker(change: dict[str, object], level: str, words: str) -> None:
    found = list(findings.docker(INFO | change))
    assert worst(found) == level
    assert any(words in finding.line() for finding in found)
