"""Hosts files of environments in a group."""

from __future__ import annotations

from containers.agents.hosts import hosts

NET = "10.128.0.0/24"


def test_group_members_precede_other_hosts_entries() -> None:
    text = "127.0.0.1\tlocalhost\n::1\tip6-localhost\n10.128.0.200\tabc\n10.127.0.2\tabc\n"
    assert hosts(text, NET, {"plan": "10.128.0.3", "map": "10.128.0.2"}) == (
        "10.128.0.2\tmap\n10.128.0.3\tplan\n127.0.0.1\tlocalhost\n::1\tip6-localhost\n10.127.0.2\tabc\n"
    )
