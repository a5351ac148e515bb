"""Instances of services: who gets which, what a robot gets in it, and how many there are."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from master.graph import catalogue, instances, sessions
from master.graph.changes import undo
from master.graph.limits import Policy
from master.graph.records import Ref
from rce.control.calls.endpoints import Bind, StartNode, StopNode
from rce.control.calls.environments import StartEnvironment
from rce.errors import AlreadyExists, InvalidRequest, LimitExceeded, NoCapacity, NotFound, Unavailable
from rce.protocol import messages as m
from tests.support.master.fleet import calls, everything
from tests.support.master.offers import declared, offering

USE = m.UseService("ann/parrot")


def test_first_robot_starts_a_shared_instance_of_the_publisher() -> None:
    fleet, _ = offering()
    outcome = fleet.do("bob", USE, robot="r1")
    (started,) = [call for call in calls(outcome.plan, "m1") if isinstance(call, StartEnvironment)]
    assert started.environment.name == "ann/parrot_1"
    assert {node.key for node in fleet.state.nodes.by("ann/parrot_1")} == {
        "ann/parrot_1/core",
        "ann/parrot_1/bob_r1_part",
    }
    assert fleet.state.nodes["ann/parrot_1/bob_r1_part"].namespace == "/bob_r1"
    assert fleet.state.parameters["ann/parrot_1/bob_r1_part:rate"].value == 2
    assert fleet.state.environments.count("bob") == 0


def test_secrets_of_a_robots_user_are_not_for_a_service_that_was_published_earlier() -> None:
    fleet, offer = offering(robots=1, most=1)
    options = replace(offer.options, secrets={"database": "URL"})
    fleet.state.offers.put(replace(offer, options=options))
    with pytest.raises(InvalidRequest, match="names secrets, which would be yours"):
        fleet.do("bob", USE, robot="r1")
    assert fleet.state.environments.count("bob") == 0


def test_robots_are_apart_in_a_shared_instance_except_where_the_service_shares() -> None:
    fleet, _ = offering()
    fleet.do("ann", USE, robot="r1")
    fleet.do("bob", USE, robot="r1")
    addresses = {each.tag: each.address for each in fleet.state.interfaces.by("ann/parrot_1")}
    assert addresses == {
        "ann_r1_say": "/ann_r1/say",
        "ann_r1_heard": "/ann_r1/heard",
        "ann_r1_news": "/news",
        "bob_r1_say": "/bob_r1/say",
        "bob_r1_heard": "/bob_r1/heard",
        "bob_r1_news": "/news",
    }
    assert {each.sender.partition("/")[0] for each in fleet.state.connections if each.user == "bob"} == {"ann", "bob"}


@pytest.mark.parametrize(
    ("one", "other"),
    [("a_b/c", "a/b_c"), ("a/b", "aZ2fb/b"), ("a_/b", "a/_b"), ("aZ/b", "aZ5a/b"), ("a/b", "A/b")],
)
def test_different_robots_have_different_namespaces(one: str, other: str) -> None:
    assert instances.namespace(one) != instances.namespace(other)
    assert instances.namespace(one).count("_") == 1


def test_answer_names_the_robots_interfaces() -> None:
    fleet, _ = offering()
    used = fleet.do("bob", m.UseService("ann/parrot", "p", raw=True), robot="r1").service
    assert used is not None
    assert (used.service, used.containerTag, used.shared) == ("ann/parrot", "p", True)
    assert {(each.name, each.iTag, each.interfaceType) for each in used.interfaces} == {
        ("say", "p_say", "SubscriberForwarder"),
        ("heard", "p_heard", "PublisherForwarder"),
        ("news", "p_news", "PublisherForwarder"),
    }


def test_robot_that_asks_again_gets_the_same_answer() -> None:
    fleet, _ = offering()
    first = fleet.do("bob", USE, robot="r1")
    before = everything(fleet.state)
    second = fleet.do("bob", USE, robot="r1")
    assert (second.plan, second.service) == ([], first.service)
    assert set(second.needs) >= set(first.needs) - {Ref("environment", "ann/parrot_1")}
    assert everything(fleet.state) == before


def test_robot_uses_a_shared_service_under_one_tag() -> None:
    fleet, _ = offering()
    fleet.do("bob", USE, robot="r1")
    with pytest.raises(AlreadyExists, match="r1 uses parrot already, with containerTag parrot"):
        fleet.do("bob", replace(USE, containerTag="other"), robot="r1")
    fleet.do("ann", replace(USE, containerTag="other"), robot="r1")


def test_connections_count_for_the_user_of_the_robot_and_the_instance_for_the_publisher() -> None:
    fleet, _ = offering()
    fleet.do("bob", USE, robot="r1")
    assert fleet.state.connections_of_user("bob") == 3
    assert fleet.state.connections_of_user("ann") == 0
    assert fleet.state.environments.count("ann") == 2
    fleet.policy = Policy(connections=5)
    fleet.do("bob", m.LeaveService("parrot"), robot="r1")
    fleet.policy = Policy(connections=2)
    before = everything(fleet.state)
    with pytest.raises(LimitExceeded):
        fleet.do("bob", USE, robot="r1")
    assert everything(fleet.state) == before


def test_full_instances_refuse_and_bounds_hold() -> None:
    fleet, _ = offering(robots=2, most=1, mostPerUser=2)
    for name in ("r2", "r3"):
        fleet.robot(f"bob/{name}")
    fleet.do("bob", USE, robot="r1")
    fleet.do("bob", USE, robot="r2")
    with pytest.raises(LimitExceeded):
        fleet.do("bob", USE, robot="r3")
    with pytest.raises(NoCapacity):
        fleet.do("ann", USE, robot="r1")
    assert fleet.state.instances.count("ann/parrot") == 1


def test_robot_that_leaves_takes_its_items_along() -> None:
    fleet, _ = offering()
    before = everything(fleet.state)
    fleet.do("ann", USE, robot="r1")
    only_ann = everything(fleet.state)
    fleet.join("ann/parrot_1", "environment", host="h2")
    joined = fleet.do("bob", USE, robot="r1")
    assert StartNode in {type(call) for call in calls(joined.plan, "ann/parrot_1")}
    plan = fleet.do("bob", m.LeaveService("parrot"), robot="r1").plan
    assert StopNode("bob_r1_part") in calls(plan, "ann/parrot_1")
    after = everything(fleet.state)
    assert {key for key in after if key.kind not in ("process", "link", "tally")} == {
        key for key in only_ann if key.kind not in ("process", "link", "tally")
    }
    sessions.robot_left(fleet.state, "ann/r1")
    assert {each.kind for each in everything(fleet.state).keys() - before.keys()} == {
        *("environment", "instance", "node", "process", "tally")
    }


def test_end_of_an_instance_ends_the_part_of_its_robots() -> None:
    fleet, _ = offering()
    fleet.do("bob", USE, robot="r1")
    plan = fleet.do("ann", m.DestroyContainer("parrot_1")).plan
    assert fleet.state.interfaces.by("bob/r1") == []
    assert len(fleet.state.uses) == len(fleet.state.instances) == 0
    assert {type(call).__name__ for call in calls(plan, "west")} == {"SendStatus", "Unbind"}


def test_publisher_and_users_do_not_reach_each_others_things() -> None:
    fleet, _ = offering()
    fleet.do("bob", USE, robot="r1")
    for user, command in (
        ("bob", m.Connect("r1/parrot_heard", "brain/pose")),
        ("bob", m.DestroyContainer("parrot_1")),
        ("bob", m.RemoveInterface("parrot_1", "bob_r1_say")),
        ("ann", m.RemoveInterface("r1", "parrot_say")),
        ("bob", m.AddNode("parrot_1", "spy", "p", "e")),
    ):
        with pytest.raises(NotFound):
            fleet.do(user, command)


def test_failed_use_leaves_a_shared_instance_for_others() -> None:
    fleet, _ = offering()
    outcome = fleet.do("bob", USE, robot="r1")
    undo(fleet.state, outcome)
    assert len(fleet.state.uses) == 0
    assert fleet.state.interfaces.by("bob/r1") == []
    assert "ann/parrot_1" in fleet.state.environments


def test_single_robots_have_instances_in_their_users_name_space() -> None:
    fleet, offer = offering(robots=1, most=1)
    outcome = fleet.do("bob", m.UseService("ann/parrot", "mine"), robot="r1")
    assert fleet.state.environments.count("bob") == 1
    assert fleet.state.instances["bob/mine"].offer == offer.name
    assert {each.address for each in fleet.state.interfaces.by("bob/mine")} == {"/say", "/heard", "/news"}
    assert {node.tag for node in fleet.state.nodes.by("bob/mine")} == {"core", "part"}
    undo(fleet.state, outcome)
    assert "bob/mine" not in fleet.state.environments


def test_tag_that_is_in_use_is_refused() -> None:
    fleet, _ = offering(robots=1, most=1)
    fleet.robot("ann/r2")
    before = everything(fleet.state)
    for tag in ("brain", "r1"):
        with pytest.raises(AlreadyExists):
            fleet.do("ann", m.UseService("parrot", tag), robot="r1")
    assert everything(fleet.state) == before
    fleet.do("ann", m.UseService("parrot"), robot="r1")
    with pytest.raises(AlreadyExists):
        fleet.do("ann", m.UseService("parrot"), robot="r2")


def test_instance_without_robot_is_taken_over_by_the_first() -> None:
    fleet, _ = offering(robots=1, most=1)
    fleet.do("bob", USE)
    assert fleet.state.instances.count("ann/parrot") == 1
    outcome = fleet.do("bob", USE, robot="r1")
    assert [call for call in calls(outcome.plan) if isinstance(call, StartEnvironment)] == []
    assert {type(call) for call in calls(outcome.plan, "west")} == {Bind}


def test_instance_of_an_older_declaration_is_not_taken_over_and_ends_without_robots() -> None:
    """It lacks what the new declaration has, and the robot would be told otherwise."""
    fleet, _ = offering(robots=1, most=1)
    fleet.do("bob", USE, robot="r1")
    catalogue.publish(fleet.state, "ann", declared(robots=1, most=1), fleet.ids)
    fleet.do("bob", m.LeaveService("parrot"), robot="r1")
    with pytest.raises(Unavailable, match="before it was published again"):
        fleet.do("bob", USE, robot="r1")
    (outdated,) = instances.idle(fleet.state, {"bob/parrot": 0.0}, 0.0)
    instances.stop(fleet.state, [outdated])
    fleet.do("bob", USE, robot="r1")
    assert fleet.state.instances["bob/parrot"].revision == fleet.state.offers["ann/parrot"].revision


def test_shared_service_needs_a_robot() -> None:
    fleet, _ = offering()
    with pytest.raises(InvalidRequest):
        fleet.do("bob", USE)
    with pytest.raises(NotFound):
        fleet.do("bob", USE, robot="r9")


def test_number_follows_load_between_the_bounds() -> None:
    fleet, offer = offering(robots=5, most=3)
    assert instances.missing(fleet.state, offer) == 0
    offer = catalogue.scale(fleet.state, offer, 1, 2)
    assert instances.missing(fleet.state, offer) == 1
    for number in range(2, 8):
        fleet.robot(f"bob/r{number}")
        fleet.do("bob", USE, robot=f"r{number}")
    counts = [fleet.state.uses.count(each.environment) for each in fleet.state.instances]
    assert (counts, instances.missing(fleet.state, offer)) == ([5, 1], 0)
    assert instances.missing(fleet.state, catalogue.scale(fleet.state, offer, 3, 9)) == 1


def test_fullest_instance_that_is_not_busy_takes_the_next_robot() -> None:
    fleet, offer = offering(robots=5, most=3)
    for _ in range(2):
        instances.start_shared(fleet.state, offer, lambda _: fleet.policy, fleet.ids)
    names = instances.instances_of(fleet.state, offer)
    for number in range(2, 9):
        fleet.robot(f"bob/r{number}")
        fleet.do("bob", USE, robot=f"r{number}")
        if number == 3:
            assert [fleet.state.uses.count(name) for name in names] == [2, 0]
    assert [fleet.state.uses.count(name) for name in names] == [4, 3]


def test_instances_without_robots_are_idle_down_to_the_lower_bound() -> None:
    fleet, offer = offering(least=1)
    for _ in range(2):
        instances.start_shared(fleet.state, offer, lambda _: fleet.policy, fleet.ids)
    names = [each.environment for each in fleet.state.instances]
    assert set(names) == instances.empty(fleet.state)
    since = dict.fromkeys(names, 100.0)
    assert instances.idle(fleet.state, since, 109.0) == []
    assert [each.name for each in instances.idle(fleet.state, since, 110.0)] == ["ann/parrot_1"]
    instances.stop(fleet.state, instances.idle(fleet.state, since, 110.0))
    assert [each.environment for each in fleet.state.instances] == ["ann/parrot_2"]


def test_shared_instance_of_an_older_declaration_takes_no_more_robots_and_ends_with_the_last() -> None:
    fleet, _ = offering(least=1)
    fleet.do("bob", USE, robot="r1")
    catalogue.publish(fleet.state, "ann", declared(least=1), fleet.ids)
    fleet.do("ann", USE, robot="r1")
    assert fleet.state.uses["ann/r1/parrot"].environment == "ann/parrot_2"
    fleet.do("bob", m.LeaveService("parrot"), robot="r1")
    assert [each.name for each in instances.idle(fleet.state, {"ann/parrot_1": 0.0}, 0.0)] == ["ann/parrot_1"]


def test_uses_are_counted_by_user() -> None:
    fleet, offer = offering()
    for _ in range(3):
        fleet.do("bob", USE, robot="r1")
        fleet.do("bob", m.LeaveService("parrot"), robot="r1")
    assert [(each.user, each.uses) for each in fleet.state.tallies.by(offer.name)] == [("bob", 3)]


def test_leaving_what_is_not_used_is_not_found() -> None:
    fleet, _ = offering()
    with pytest.raises(NotFound):
        fleet.do("bob", m.LeaveService("parrot"), robot="r1")
    assert fleet.do("bob", m.LeaveService("parrot"), robot="r1", again=True).plan == []
