"""Quality of service: profiles that match the publishers and subscriptions that a topic already has."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from rce.protocol.messages import Qos
from rce.protocol.messages.commands import DEEP, SHALLOW

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
TRANSIENT_LOCAL, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
_reliability = {"reliable": RELIABLE, "best_effort": BEST_EFFORT}
_durability = {"transient_local": TRANSIENT_LOCAL, "volatile": VOLATILE}


def for_subscription(qos: Qos, publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Return a profile that matches all `publishers`.

    Unless `qos` says otherwise it is reliable and transient_local as far as all of them offer that.
    """
    best_effort = any(info.qos_profile.reliability == BEST_EFFORT for info in publishers)
    latched = bool(publishers) and all(info.qos_profile.durability == TRANSIENT_LOCAL for info in publishers)
    return _profile(qos, BEST_EFFORT if best_effort else RELIABLE, TRANSIENT_LOCAL if latched else VOLATILE)


def for_publisher(qos: Qos, subscriptions: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Return a profile that matches all `subscriptions`.

    Unless `qos` says otherwise it is reliable, and transient_local if one of them requests that.
    """
    latched = any(info.qos_profile.durability == TRANSIENT_LOCAL for info in subscriptions)
    return _profile(qos, RELIABLE, TRANSIENT_LOCAL if latched else VOLATILE)


def _profile(qos: Qos, reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    keep_all = qos.history == "keep_all"
    reliability = _reliability.get(qos.reliability, reliability)
    durability = _durability.get(qos.durability, durability)
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=0 if keep_all else qos.depth or (DEEP if (reliability, durability) == (RELIABLE, VOLATILE) else SHALLOW),
        reliability=reliability,
        durability=durability,
    )


def mismatch(publisher: QoSProfile, subscription: QoSProfile) -> str:
    """Return why the two profiles do not match; empty when they do.

    Deadlines and leases are not compared: ours are infinite, which matches every publisher.
    """
    if subscription.reliability == RELIABLE and publisher.reliability == BEST_EFFORT:
        return "a reliable subscription does not match a best_effort publisher"
    if is_latched(subscription) and not is_latched(publisher):
        return "a transient_local subscription does not match a volatile publisher"
    return ""


def is_latched(profile: QoSProfile) -> bool:
    """Return True if late subscriptions get earlier messages (durability transient_local)."""
    return bool(profile.durability == TRANSIENT_LOCAL)


def describe(profile: QoSProfile) -> str:
    """Return reliability and durability of a profile as text."""
    return f"{profile.reliability.name.lower()}, {profile.durability.name.lower()}"
