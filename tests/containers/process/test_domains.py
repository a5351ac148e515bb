"""Allocation of ROS domains: exclusive on the host, and apart from those in use."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from containers.process.domains import Domains
from rce.errors import NoCapacity
from tests.support.domains import domain


def test_domain_with_foreign_participants_is_not_allocated(tmp_path: Path) -> None:
    number = domain("foreign participant")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", 7400 + 250 * number + 10))
        with pytest.raises(NoCapacity):
            Domains(tmp_path, range(number, number + 1)).take()
    allocated, lock = Domains(tmp_path, range(number, number + 1)).take()
    os.close(lock)
    assert allocated == number


def test_domains_are_allocated_exclusively(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("containers.process.domains._in_use", set)
    domains = Domains(tmp_path / "domains")
    first, lock = domains.take()
    second, other = domains.take()
    os.close(lock)
    third, again = domains.take()
    os.close(other)
    os.close(again)
    assert (second > first, third) == (True, first)


def test_all_domains_in_use_is_no_capacity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("containers.process.domains._in_use", set)
    domains = Domains(tmp_path / "domains", range(90, 92))
    held = [domains.take() for _ in range(2)]
    assert [number for number, _ in held] == [90, 91]
    with pytest.raises(NoCapacity, match="all 2 ROS domains") as raised:
        domains.take()
    assert raised.value.info.fields == {"domains": 2}
    for _, lock in held:
        os.close(lock)


def test_inherited_lock_holds_the_domain(tmp_path: Path) -> None:
    """The environment's process holds it when the task set has ended."""
    domains = Domains(tmp_path / "domains")
    lock = domains.hold(5)
    assert lock is not None
    inherited = os.dup(lock)
    os.close(lock)
    assert domains.hold(5) is None
    os.close(inherited)
    again = domains.hold(5)
    assert again is not None
    os.close(again)


def test_directory_is_shared_by_all_users(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        lock = Domains(tmp_path / "domains").hold(5)
    finally:
        os.umask(before)
    assert lock is not None
    os.close(lock)
    assert (tmp_path / "domains").stat().st_mode & 0o7777 == 0o1777


def test_symbolic_link_in_place_of_a_lock_is_not_followed(tmp_path: Path) -> None:
    """Everybody can write to the directory."""
    domains = Domains(tmp_path)
    (tmp_path / "5").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="5"):
        domains.hold(5)
    assert not (tmp_path / "elsewhere").exists()
