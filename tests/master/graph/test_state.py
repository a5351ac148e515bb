"""State of the graph: indexes of its tables, changes for the store, and watchers."""

from __future__ import annotations

import pytest

from master.graph.records import Connection, Environment, EnvironmentOptions, Interface, Node, Process, Ref, Robot
from master.graph.state import State, Table
from rce.api.roles import Principal

NODE = Node("ann/brain", "echo", "p", "e")


@pytest.fixture
def nodes() -> Table[Node]:
    return State().nodes


def test_record_is_found_by_key_and_by_term(nodes: Table[Node]) -> None:
    nodes.put(NODE)
    assert nodes["ann/brain/echo"] is NODE
    assert nodes.by("ann/brain") == [NODE]
    assert (nodes.count("ann/brain"), nodes.count("ann")) == (1, 0)


def test_removed_record_is_not_found(nodes: Table[Node]) -> None:
    nodes.put(NODE)
    assert nodes.drop(NODE.key) is NODE
    assert nodes.drop(NODE.key) is None
    assert nodes.get(NODE.key) is None
    assert nodes.by("ann/brain") == []


def test_changes_are_collected_for_the_store(nodes: Table[Node]) -> None:
    nodes.load(NODE)
    assert nodes.changed == set()
    nodes.drop(NODE.key)
    assert nodes.changed == {NODE.key}
    assert nodes.removed() == [Ref("node", "ann/brain/echo")]


def test_watchers_get_the_record_before_and_after(nodes: Table[Node]) -> None:
    seen: list[tuple[Node | None, Node | None]] = []
    nodes.watchers.append(lambda before, after: seen.append((before, after)))
    other = Node("ann/brain", "echo", "p", "other")
    nodes.put(NODE)
    nodes.put(other)
    nodes.drop(NODE.key)
    assert seen == [(None, NODE), (NODE, other), (other, None)]


def test_sums_follow_records_that_change_and_go() -> None:
    state = State()
    for name, cpu in (("ann/one", 0.1), ("ann/two", 0.2), ("bob/three", 4.0)):
        state.environments.put(Environment(name, EnvironmentOptions(size=2, cpu=cpu), "run", "m1"))
    totals = [state.environments.total(term, "cores") for term in ("ann", "@m1", "nobody")]
    assert totals == [0.3, 4.3, 0.0]
    state.environments.put(Environment("ann/two", EnvironmentOptions(size=3, cpu=1.0), "run", "m2"))
    assert [state.environments.total(term, "size") for term in ("ann", "@m1", "@m2")] == [5, 4, 3]
    for name in ("ann/one", "ann/two"):
        state.environments.drop(name)
    assert state.environments.total("ann", "size") == 0


# --- state ------------------------------------------------------------------------------------------------------------


def test_robots_and_connections_of_guests_do_not_count_for_the_owner() -> None:
    state = State()
    state.robots.put(Robot("ann/r1", "west", "s"))
    state.robots.put(Robot("ann/@own", "west", "s", Principal("ann", "user")))
    state.robots.put(Robot("ann/@bobs", "west", "s", Principal("bob", "operator")))
    for number, owner in enumerate(("ann/brain", "ann/r1", "ann/@bobs")):
        state.interfaces.put(Interface(f"{number:032}", owner, "x", "", "std_msgs/String"))
    state.connections.put(Connection("ann/brain/x", "ann/r1/x"))
    state.connections.put(Connection("ann/brain/x", "ann/@bobs/x"))
    assert (state.robots_of_user("ann"), state.connections_of_user("ann")) == (2, 1)
    assert (state.robots_of_user("bob"), state.connections_of_user("bob")) == (0, 0)


def test_connection_is_found_by_its_sides_and_its_link() -> None:
    state = State()
    connection = Connection("ann/brain/x", "ann/r1/y", "link")
    state.connections.put(connection)
    for term in ("ann/brain/x", "ann/r1/y", "link"):
        assert state.connections.by(term) == [connection]
    state.connections.put(Connection("ann/brain/x", "ann/r1/y"))
    assert state.connections.by("link") == []


def test_process_is_gone_when_it_is_neither_joined_nor_expected() -> None:
    state = State()
    state.processes.put(Process("m1", "container", "1"))
    assert state.gone("m1")
    state.expected.add("m1")
    assert not state.gone("m1")
    state.joined.add("m1")
    state.forget("m1")
    assert state.gone("m1")
    assert len(state.processes) == 0


def test_host_is_the_endpoint_while_that_is_connected() -> None:
    state = State()
    state.robots.put(Robot("ann/r1", "west", "s"))
    state.joined |= {"west", "ann/brain"}
    assert [state.host(owner) for owner in ("ann/r1", "ann/brain", "ann/other")] == ["west", "ann/brain", ""]
    state.joined.clear()
    assert [state.host(owner) for owner in ("ann/r1", "ann/brain")] == ["", ""]
