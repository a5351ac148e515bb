"""An environment in a group finds out by itself where it is, if only the subnet is known."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from endpoints.environment import group
from endpoints.environment.settings import Settings
from rce.errors import StartFailed


@pytest.fixture(autouse=True)
def names(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    known = {"here": "10.128.3.5", "beside": "10.128.3.6"}

    def resolve(name: str) -> str:
        if name not in known:
            raise socket.gaierror(name)
        return known[name]

    monkeypatch.setattr(socket, "gethostname", lambda: "here")
    monkeypatch.setattr(socket, "gethostbyname", resolve)
    monkeypatch.setattr(socket, "gethostbyname_ex", lambda name: (name, [], ["172.17.0.2", resolve(name)]))
    monkeypatch.setattr(group, "PATIENCE", 0.0)
    monkeypatch.setattr(group, "PAUSE", 0.0)
    return known


def settings(address: str, *peers: str) -> Settings:
    return Settings("ann/map", "0" * 32, "token", "tcp:127.0.0.1:1", Path("/tmp"), address=address, peers=list(peers))


def test_an_address_stays() -> None:
    assert group.settled(settings("10.0.0.1", "10.0.0.2")) == settings("10.0.0.1", "10.0.0.2")


def test_the_own_address_in_the_subnet_and_those_of_members_that_are_known() -> None:
    found = group.settled(settings("10.128.3.0/24", "beside", "absent"))
    assert (found.address, found.peers) == ("10.128.3.5", ["10.128.3.6"])


def test_a_member_that_appears_in_time(names: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(group, "PATIENCE", 60.0)
    monkeypatch.setattr("time.sleep", lambda _: names.update(late="10.128.3.7"))
    assert group.settled(settings("10.128.3.0/24", "late")).peers == ["10.128.3.7"]


def test_without_an_address_there_it_does_not_start() -> None:
    with pytest.raises(StartFailed, match=r"10\.1\.0\.0/24"):
        group.settled(settings("10.1.0.0/24"))
