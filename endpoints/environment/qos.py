"""Quality of service: from the words of an interface to profiles that fit what a topic already has."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from rce.messages import Qos

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
TRANSIENT_LOCAL, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
_reliability = {"reliable": RELIABLE, "best_effort": BEST_EFFORT}
_durability = {"transient_local": TRANSIENT_LOCAL, "volatile": VOLATILE}


def for_subscription(qos: Qos, publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """What hears all `publishers`: reliable, and with what they keep for late ones, as far as all of them offer it."""
    best_effort = any(info.qos_profile.reliability == BEST_EFFORT for info in publishers)
    latched = bool(publishers) and all(info.qos_profile.durability == TRANSIENT_LOCAL for info in publishers)
    return _profile(qos, BEST_EFFORT if best_effort else RELIABLE, TRANSIENT_LOCAL if latched else VOLATILE)


def for_publisher(qos: Qos, subscriptions: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """What all `subscriptions` hear: reliable, and kept for late ones if one of them asks for it."""
    latched = any(info.qos_profile.durability == TRANSIENT_LOCAL for info in subscriptions)
    return _profile(qos, RELIABLE, TRANSIENT_LOCAL if latched else VOLATILE)


def _profile(qos: Qos, reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    keep_all = qos.history == "keep_all"
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=0 if keep_all else qos.depth,
        reliability=_reliability.get(qos.reliability, reliability),
        durability=_durability.get(qos.durability, durability),
    )


def mismatch(publisher: QoSProfile, subscription: QoSProfile) -> str:
    """Why these two do not match; empty when they do.

    Deadlines and leases are not looked at: ours are infinite, which every publisher offers.
    """
    if subscription.reliability == RELIABLE and publisher.reliability == BEST_EFFORT:
        return "a reliable subscription hears no best_effort publisher"
    if is_latched(subscription) and not is_latched(publisher):
        return "a transient_local subscription hears no volatile publisher"
    return ""


def is_latched(profile: QoSProfile) -> bool:
    """Whether late subscriptions get what was published before."""
    return bool(profile.durability == TRANSIENT_LOCAL)


def words(profile: QoSProfile) -> str:
    return f"{profile.reliability.name.lower()}, {profile.durability.name.lower()}"
