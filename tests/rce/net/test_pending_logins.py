"""Connections that have not logged in, counted by address."""

from __future__ import annotations

import pytest

from rce.net import pending_logins
from rce.net.pending_logins import PendingLogin, PendingLogins, network


@pytest.fixture
def logins(monkeypatch: pytest.MonkeyPatch) -> PendingLogins:
    monkeypatch.setattr(pending_logins, "MAX_PENDING", 3)
    return PendingLogins(lambda: 0.0)


def begin(logins: PendingLogins, address: str) -> PendingLogin:
    pending = logins.begin(address)
    assert pending is not None
    return pending


def test_address_with_too_many_pending_connections_gets_no_further_one(logins: PendingLogins) -> None:
    for _ in range(3):
        begin(logins, "10.0.0.1")
    assert logins.begin("10.0.0.1") is None
    begin(logins, "10.0.0.2")


def test_login_makes_room_once(logins: PendingLogins) -> None:
    first, _, _ = (begin(logins, "10.0.0.1") for _ in range(3))
    first.end()
    first.end()
    begin(logins, "10.0.0.1")
    assert logins.begin("10.0.0.1") is None


def test_nothing_is_kept_of_addresses_without_pending_connections(logins: PendingLogins) -> None:
    for number in range(100):
        begin(logins, f"10.0.0.{number}").end()
    assert not logins._counts


def test_this_machine_has_no_bound(logins: PendingLogins) -> None:
    for _ in range(10):
        begin(logins, "127.0.0.1")


def test_refusals_are_logged_once_a_minute(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(pending_logins, "MAX_PENDING", 0)
    now = [0.0]
    logins = PendingLogins(lambda: now[0])
    for now[0] in (0.0, 1.0, 59.0, 60.0):
        assert logins.begin("10.0.0.1") is None
    assert caplog.text.count("10.0.0.1") == 2


@pytest.mark.parametrize(
    ("address", "counts_as"),
    [
        ("10.1.2.3", "10.1.2.3"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("::ffff:10.1.2.3", "10.1.2.3"),
        ("fe80::1%eth0", "fe80::/64"),
        *((own, "") for own in ("127.0.0.1", "::1", "::ffff:127.0.0.1", "", "unix")),
    ],
)
def test_ipv6_networks_count_as_one_address(address: str, counts_as: str) -> None:
    assert network(address) == counts_as
