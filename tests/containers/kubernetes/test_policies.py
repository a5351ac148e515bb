"""NetworkPolicy objects of a task set."""

from __future__ import annotations

from containers.kubernetes.policies import group_policy, policies


def test_environments_are_closed_unless_a_policy_of_their_egress_opens_them() -> None:
    closed, internet, everything, listed = (each["spec"] for each in policies("rce", "t"))
    assert closed["podSelector"]["matchLabels"] == {"rce/task-set": "t"}
    assert (closed["ingress"], closed["egress"]) == ([], [])
    assert closed["policyTypes"] == ["Ingress", "Egress"]
    assert internet["podSelector"]["matchLabels"]["rce/egress"] == "internet"
    (block,) = internet["egress"][0]["to"]
    assert {"10.0.0.0/8", "169.254.0.0/16"} <= set(block["ipBlock"]["except"])
    assert everything["egress"] == listed["egress"] == [{}], "the filter of a pod has the addresses of a list"
    assert all(each["ingress"] == [] for each in (internet, everything, listed))


def test_members_of_a_group_reach_each_other_by_its_tunnel_only() -> None:
    spec = group_policy("rce", "t", "g")["spec"]
    (inward,), (outward,) = spec["ingress"], spec["egress"]
    assert (
        inward["from"] == outward["to"] == [{"podSelector": {"matchLabels": {"rce/task-set": "t", "rce/group": "g"}}}]
    )
    assert inward["ports"] == outward["ports"] == [{"protocol": "UDP", "port": 4789}]
