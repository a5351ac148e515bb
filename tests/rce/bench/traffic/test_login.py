"""Logins of the benchmark's robots."""

from __future__ import annotations

from urllib.parse import parse_qs

from rce.bench.traffic.login import Login


def test_query_has_what_a_login_needs() -> None:
    query = parse_qs(Login("http://127.0.0.1:9000/", "ann", "rce_1").query("r2", "ack"))
    assert query == {"userID": ["ann"], "robotID": ["r2"], "key": ["rce_1"], "features": ["ack"]}
