"""Addresses of this machine."""

from __future__ import annotations

import pytest

from rce.net.loopback import is_loopback


@pytest.mark.parametrize(
    ("host", "own"),
    [("localhost", True), ("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("10.0.0.1", False), ("a.b", False)],
)
def test_loopback_is_recognized(host: str, own: bool) -> None:
    assert is_loopback(host) is own
