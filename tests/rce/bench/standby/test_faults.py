"""Choice of faults."""

from __future__ import annotations

import random

from rce.bench.standby.faults import CHOICES, DEPOSING, LONG, Fault, choose


def chosen(clocks: bool) -> list[Fault]:
    rng = random.Random(1)
    return [choose(rng, clocks) for _ in range(1000)]


def test_all_faults_happen() -> None:
    assert {(fault.kind, fault.victim) for fault in chosen(clocks=True)} == set(CHOICES)


def test_clocks_that_cannot_jump_are_left_alone() -> None:
    assert "clock" not in {fault.kind for fault in chosen(clocks=False)}


def test_leader_that_fails_for_longer_than_its_lease_is_deposed() -> None:
    for fault in chosen(clocks=True):
        assert fault.deposes == (fault.seconds >= LONG[0]) == (fault.kind in DEPOSING)


def test_same_seed_chooses_the_same() -> None:
    assert chosen(clocks=True) == chosen(clocks=True)
