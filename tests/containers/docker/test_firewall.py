"""Packet filter rules of environments, with a stand-in for iptables."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from containers.docker import firewall
from containers.docker.firewall import FORWARDED, NOT_THE_INTERNET, TO_HOST, Firewall, egress_rules, group_rules
from rce.errors import Unavailable

OTHERS = ["-P INPUT ACCEPT", "-A INPUT -i eth0 -m comment --comment other -j DROP"]
LIST = """#!/bin/sh
cd "$(dirname "$0")"
case $3 in
-S) [ -n "$4" ] && cat "$4" || cat all ;;
*) echo "$3" "$4" "$5" "$6" >> done ;;
esac
"""
RESTORE = """#!/bin/sh
cat > "$(dirname "$0")/restored"
"""
FAIL = """#!/bin/sh
echo "iptables: No chain/target/match by that name." >&2
exit 1
"""


class Tables:
    """Stand-in: `iptables -S` prints a file for each chain, `iptables-restore` keeps its input."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.program("iptables", LIST)
        self.program("iptables-restore", RESTORE)
        self.set(FORWARDED)
        self.set(TO_HOST)

    def program(self, name: str, text: str) -> None:
        (self.directory / name).write_text(text)
        (self.directory / name).chmod(0o755)

    def set(self, chain: str, *rules: str) -> None:
        lines = [*OTHERS, *(f"-A {chain} {rule}" for rule in rules)]
        (self.directory / chain).write_text("".join(f"{line}\n" for line in lines))

    def set_all(self, lines: list[str]) -> None:
        """Set what `iptables -S` prints for all chains."""
        (self.directory / "all").write_text("".join(f"{line}\n" for line in lines))

    @property
    def done(self) -> list[str]:
        """Return the other commands."""
        file = self.directory / "done"
        return [line.strip() for line in file.read_text().splitlines()] if file.exists() else []

    @property
    def restored(self) -> list[str]:
        file = self.directory / "restored"
        return file.read_text().splitlines() if file.exists() else []


@pytest.fixture
def tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Tables:
    """Tables of a machine with the bridges rce-a and rce-b."""

    def index(name: str) -> int:
        if name not in ("rce-a", "rce-b"):
            raise OSError("no such device")
        return 1

    monkeypatch.setattr(socket, "if_nametoindex", index)
    monkeypatch.setattr(firewall, "PATH", f"{tmp_path}:/usr/bin:/bin")
    return Tables(tmp_path)


async def test_rules_of_a_bridge_are_replaced_in_one_step(tables: Tables) -> None:
    old = "-i rce-a -m comment --comment rce-a -j DROP"
    tables.set(FORWARDED, old, "-i rce-b -m comment --comment rce-b -j DROP")
    await Firewall().set_rules("rce-a", [(FORWARDED, "-i", "rce-a", "-j", "ACCEPT"), (TO_HOST, "-i", "rce-a")])
    assert tables.restored == [
        "*filter",
        f"-D {FORWARDED} {old}",
        f"-I {TO_HOST} -i rce-a -m comment --comment rce-a",
        f"-I {FORWARDED} -i rce-a -j ACCEPT -m comment --comment rce-a",
        "COMMIT",
    ]


async def test_rules_of_one_bridge_are_removed(tables: Tables) -> None:
    rules = {name: f"-i {name} -m comment --comment {name} -j DROP" for name in ("rce-a", "rce-b")}
    tables.set(TO_HOST, *rules.values())
    await Firewall().remove_rules("rce-b")
    assert tables.restored == ["*filter", f"-D {TO_HOST} {rules['rce-b']}", "COMMIT"]


async def test_rules_of_bridges_that_are_gone_are_swept(tables: Tables) -> None:
    gone = "-i rce-gone -m comment --comment rce-gone -j DROP"
    tables.set(FORWARDED, "-i rce-a -m comment --comment rce-a -j DROP", gone)
    await Firewall().sweep()
    assert tables.restored == ["*filter", f"-D {FORWARDED} {gone}", "COMMIT"]


async def test_nothing_is_changed_without_rules_to_remove(tables: Tables) -> None:
    await Firewall().remove_rules("rce-a")
    await Firewall().sweep()
    assert tables.restored == []


RULE = "-i rce-a -m comment --comment rce-a -j DROP"
SET = f"-A {FORWARDED} {RULE}"


@pytest.mark.parametrize(
    ("present", "changed"),
    [
        ([f"-N {FORWARDED}", f"-A FORWARD -j {FORWARDED}", "-A INPUT -j LOG", SET], False),
        ([f"-N {FORWARDED}", f"-A FORWARD -j {FORWARDED}"], True),
        ([f"-N {FORWARDED}", SET], True),
        ([], True),
    ],
)
async def test_missing_rule_or_jump_is_noticed(tables: Tables, present: list[str], changed: bool) -> None:
    tables.set(FORWARDED, RULE)
    filters = Firewall()
    assert not await filters.changed()  # as there are no rules of its own
    await filters.set_rules("rce-a", [(FORWARDED, "-i", "rce-a", "-j", "DROP")])
    tables.set_all(present)
    assert await filters.changed() == changed
    tables.set(FORWARDED)
    await filters.remove_rules("rce-a")
    assert not await filters.changed()


@pytest.mark.parametrize(
    ("present", "done"),
    [
        ([f"-N {FORWARDED}", f"-A FORWARD -j {FORWARDED}"], []),
        ([f"-N {FORWARDED}"], [f"-I FORWARD -j {FORWARDED}"]),
        ([], [f"-N {FORWARDED}", f"-I FORWARD -j {FORWARDED}"]),
    ],
)
async def test_chain_is_restored(tables: Tables, present: list[str], done: list[str]) -> None:
    tables.set_all(present)
    await Firewall().restore_chain()
    assert tables.done == done


async def test_bridge_on_another_machine_is_refused(tables: Tables) -> None:
    with pytest.raises(Unavailable, match="bridge rce-c is not on this machine"):
        await Firewall().set_rules("rce-c", group_rules("rce-c"))
    assert tables.restored == []


async def test_failure_is_reported_with_its_reason(tables: Tables) -> None:
    tables.program("iptables", FAIL)
    with pytest.raises(Unavailable, match=r"-S DOCKER-USER failed: .*by that name.*\(Docker creates this chain"):
        await Firewall().sweep()


async def test_missing_program_is_named(tables: Tables, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(firewall, "PATH", "/nonexistent")
    with pytest.raises(Unavailable, match="no iptables: install it"):
        await Firewall().set_rules("rce-a", group_rules("rce-a"))


def test_group_members_reach_each_other_only() -> None:
    accept, *drops = group_rules("rce-a")
    assert accept == (FORWARDED, "-i", "rce-a", "-o", "rce-a", "-j", "ACCEPT")
    assert {rule[:3] for rule in drops} == {
        (FORWARDED, "-i", "rce-a"),
        (FORWARDED, "-o", "rce-a"),
        (TO_HOST, "-i", "rce-a"),
    }
    assert all(rule[-1] == "DROP" for rule in drops)


def test_egress_to_everything_still_excludes_other_environments() -> None:
    rules = egress_rules("rce-a", "all")
    assert (FORWARDED, "-i", "rce-a", "-o", "rce-+", "-j", "DROP") in rules
    assert not any("-d" in rule or rule[0] == TO_HOST for rule in rules)


def test_egress_to_listed_addresses_excludes_all_others_and_the_host() -> None:
    rules = egress_rules("rce-a", "10.0.0.5:5432,192.0.2.0/28:443")
    for chain in (FORWARDED, TO_HOST):
        own = [words for of, *words in rules if of == chain and words[-1] in ("RETURN", "DROP") and words[0] == "-i"]
        allowed = [each for each in own if each[-1] == "RETURN"]
        assert [(each[3], each[5], each[7]) for each in allowed] == [
            ("10.0.0.5", "tcp", "5432"),
            ("192.0.2.0/28", "tcp", "443"),
        ]
        assert own[-1] == ["-i", "rce-a", "-j", "DROP"]
    assert ["-i", "rce-a", "-o", "rce-+", "-j", "DROP"] in [words for _, *words in rules[:3]]


def test_egress_to_the_internet_excludes_private_networks_and_the_host() -> None:
    rules = egress_rules("rce-a", "internet")
    refused = {rule[rule.index("-d") + 1] for rule in rules if "-d" in rule and rule[-1] == "DROP"}
    assert refused == set(NOT_THE_INTERNET)
    assert {"10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "169.254.0.0/16", "127.0.0.0/8"} <= refused
    assert (TO_HOST, "-i", "rce-a", "-j", "DROP") in rules


def test_replies_are_let_in_before_the_rest_is_dropped() -> None:
    replies, rest, *_ = egress_rules("rce-a", "internet")
    assert "ESTABLISHED,RELATED" in replies
    assert replies[-1] == "RETURN"
    assert rest == (FORWARDED, "-o", "rce-a", "-j", "DROP")
