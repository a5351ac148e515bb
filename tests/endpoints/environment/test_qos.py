"""Quality of service that matches the publishers and subscriptions at the other side of a topic."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.environment.qos import describe, for_publisher, for_subscription, is_latched, mismatch
from rce.protocol.messages import Qos
from rce.protocol.messages.commands import DEEP, SHALLOW

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
PROFILES = list(product((RELIABLE, BEST_EFFORT), (LATCHED, VOLATILE)))
AUTO = Qos()
Choose = Callable[[Qos, list[TopicEndpointInfo]], QoSProfile]


def profile(reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(depth=1, reliability=reliability, durability=durability)


def nodes(*kinds: tuple[ReliabilityPolicy, DurabilityPolicy]) -> list[TopicEndpointInfo]:
    return [TopicEndpointInfo(qos_profile=profile(*kind)) for kind in kinds]


def chosen(found: QoSProfile) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
    return found.reliability, found.durability


def test_topic_without_nodes_is_reliable_and_volatile() -> None:
    assert chosen(for_subscription(AUTO, [])) == (RELIABLE, VOLATILE)
    assert chosen(for_publisher(AUTO, [])) == (RELIABLE, VOLATILE)


@pytest.mark.parametrize("kinds", [*product(PROFILES, repeat=1), *product(PROFILES, repeat=2)])
def test_subscription_matches_all_publishers(kinds: tuple[tuple[ReliabilityPolicy, DurabilityPolicy], ...]) -> None:
    found = for_subscription(AUTO, nodes(*kinds))
    assert [mismatch(profile(*kind), found) for kind in kinds] == [""] * len(kinds)
    assert (found.reliability == RELIABLE) == all(reliability == RELIABLE for reliability, _ in kinds)
    assert is_latched(found) == all(durability == LATCHED for _, durability in kinds)


@pytest.mark.parametrize("kinds", [*product(PROFILES, repeat=1), *product(PROFILES, repeat=2)])
def test_publisher_matches_all_subscriptions(kinds: tuple[tuple[ReliabilityPolicy, DurabilityPolicy], ...]) -> None:
    found = for_publisher(AUTO, nodes(*kinds))
    assert [mismatch(found, profile(*kind)) for kind in kinds] == [""] * len(kinds)
    assert found.reliability == RELIABLE
    assert is_latched(found) == any(durability == LATCHED for _, durability in kinds)


def test_given_qos_takes_precedence() -> None:
    qos = Qos(reliability="best_effort", durability="volatile")
    assert chosen(for_subscription(qos, nodes((RELIABLE, LATCHED)))) == (BEST_EFFORT, VOLATILE)
    qos = Qos(reliability="reliable", durability="transient_local")
    assert chosen(for_publisher(qos, nodes((BEST_EFFORT, VOLATILE)))) == (RELIABLE, LATCHED)


@pytest.mark.parametrize("choose", [for_publisher, for_subscription])
def test_history_and_depth_are_those_of_interface(choose: Choose) -> None:
    newest = choose(Qos(depth=7), [])
    assert (newest.history, newest.depth) == (HistoryPolicy.KEEP_LAST, 7)
    assert choose(Qos(), []).depth == DEEP
    assert choose(Qos("best_effort"), []).depth == SHALLOW
    assert choose(Qos(durability="transient_local"), []).depth == SHALLOW, "as many as a late node gets"
    assert choose(Qos(history="keep_all", depth=7), []).history == HistoryPolicy.KEEP_ALL


def test_mismatch_names_the_reason() -> None:
    assert "reliable" in mismatch(profile(BEST_EFFORT, LATCHED), profile(RELIABLE, LATCHED))
    assert "transient_local" in mismatch(profile(RELIABLE, VOLATILE), profile(RELIABLE, LATCHED))
    assert mismatch(profile(RELIABLE, LATCHED), profile(BEST_EFFORT, VOLATILE)) == ""


def test_profile_is_described_by_reliability_and_durability() -> None:
    assert describe(profile(BEST_EFFORT, LATCHED)) == "best_effort, transient_local"
