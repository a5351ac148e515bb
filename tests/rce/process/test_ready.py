"""Announcement of a program's readiness."""

from __future__ import annotations

import pytest

from rce.process.ready import Ready, announce, parse


@pytest.mark.parametrize(
    "ready", [Ready("container"), Ready("master", "http://127.0.0.1:9000/", "tcp:127.0.0.1:8080"), Ready("x", "ü\n")]
)
def test_announcement_is_one_line_that_the_parent_reads(ready: Ready, capfd: pytest.CaptureFixture[str]) -> None:
    announce(ready)
    out = capfd.readouterr().out
    assert out.count("\n") == 1
    assert parse(out.encode()) == ready


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"\n",
        b"a line of a program\n",
        b"{}\n",
        b"[1]\n",
        b'{"program": 5}\n',
        b'{"program": "\xff"}\n',
        b'{"program": "x", "url": ' + b"[" * 50_000 + b"\n",
    ],
)
def test_other_output_is_no_announcement(line: bytes) -> None:
    assert parse(line) is None
