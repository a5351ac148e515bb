"""Network groups: their subnets, addresses, members and machine."""

from __future__ import annotations

from ipaddress import IPv4Network

import pytest

from master.graph import groups, reconcile
from master.graph.commands import CommandContext, execute
from master.graph.limits import Policy, parse
from rce.control.calls.environments import Group, StartEnvironment
from rce.errors import AlreadyExists, InvalidRequest, NoCapacity
from rce.protocol import messages as m
from tests.support.master.fleet import calls
from tests.support.master.machines import machines, placed


def test_group_addresses_are_assigned_and_checked() -> None:
    fleet = machines(big=300)
    for number in range(253):
        placed(fleet, "ann", f"e{number}", group="g")
    given = [each.address for each in fleet.state.environments]
    assert (given[0], given[-1], len(set(given))) == ("10.128.0.2", "10.128.0.254", 253)
    with pytest.raises(NoCapacity, match="full"):
        placed(fleet, "ann", "more", group="g")
    placed(fleet, "ann", "elsewhere", group="h", groupIp="192.168.1.2")
    placed(fleet, "bob", "e0", group="g", groupIP="192.168.1.2")
    fleet.do("ann", m.DestroyContainer("e7"))
    with pytest.raises(AlreadyExists, match=r"192\.168\.1\.8"):
        placed(fleet, "ann", "again", group="g", groupIP="192.168.1.8")
    placed(fleet, "ann", "again", group="g", groupIP="192.168.1.9")  # the address of e7
    placed(
        fleet, "ann", "own", group="h", groupIP="10.128.1.3"
    )  # in the group's own subnet, as the event `ready` tells it
    assert groups.of_user(fleet.state, "bob") == {"g": {"bob/e0": "10.128.2.2"}}
    assert fleet.state.environments["ann/elsewhere"].address == "10.128.1.2"
    assert fleet.state.environments["ann/again"].address == "10.128.0.9"


def test_group_keeps_its_subnet_while_it_has_members() -> None:
    fleet = machines(big=10)
    placed(fleet, "ann", "a", group="g")
    placed(fleet, "ann", "b", group="h")
    fleet.do("ann", m.DestroyContainer("a"))
    placed(fleet, "ann", "c", group="h")
    placed(fleet, "bob", "d", group="g")  # gets the subnet that ann's group had
    assert [each.subnet for each in fleet.state.environments] == ["10.128.1.0/24", "10.128.1.0/24", "10.128.0.0/24"]
    fleet.state.group_pool = IPv4Network("10.128.0.0/23")
    with pytest.raises(NoCapacity, match=r"10\.128\.0\.0/23"):
        placed(fleet, "bob", "e", group="more")


def test_group_members_get_each_others_addresses() -> None:
    fleet = machines(big=10)
    placed(fleet, "ann", "a", group="g")
    placed(fleet, "bob", "a", group="g")
    plan = fleet.do("ann", m.CreateContainer("b", m.ContainerData(group="g", groupIP="192.168.1.77"))).plan
    (call,) = (call for call in calls(plan, "big") if isinstance(call, StartEnvironment))
    assert call.environment.group == Group(
        "ann/g", "10.128.0.0/24", "10.128.0.77", {"a": "10.128.0.2", "b": "10.128.0.77"}
    )


def test_group_stays_on_one_machine() -> None:
    fleet = machines(small=3, big=9)
    placed(fleet, "ann", "first", group="g", size=1)
    home = fleet.state.environments["ann/first"].machine
    assert home == "big"
    placed(fleet, "bob", "filler", size=8)
    with pytest.raises(NoCapacity, match="machine big, which has network group g, has not 1 free slots"):
        placed(fleet, "ann", "second", group="g")
    placed(fleet, "ann", "other", group="h")
    assert fleet.state.environments["ann/other"].machine == "small"


def test_egress_policy_holds_in_all_lives_of_an_environment() -> None:
    fleet = machines(big=9)
    command = m.CreateContainer("a")
    context = CommandContext(fleet.state, "ann", fleet.ids, Policy(egress="internet"))
    plan = execute(context, command).plan
    (first,) = calls(plan, "big")
    again = reconcile.restart(fleet.state, fleet.state.environments["ann/a"], fleet.ids)
    (second,) = calls(again, "big")
    assert isinstance(first, StartEnvironment)
    assert isinstance(second, StartEnvironment)
    assert first.environment.egress == second.environment.egress == "internet"
    assert parse(["egress=all"]) == {"egress": "all"}
    with pytest.raises(InvalidRequest, match="egress"):
        parse(["egress=some"])
