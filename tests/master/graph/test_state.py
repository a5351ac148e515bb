"""State of the graph: indexes of its tables, changes for the store, and watchers."""

from __future__ import annotations

import pytest

from master.graph.records import Node, Parameter, Ref, ref
from master.graph.state import State, Table

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


def test_references_tell_kinds_apart() -> None:
    parameter = Parameter("ann/brain", "rate", 5, "echo")
    assert parameter.key == "ann/brain/echo:rate"
    assert str(ref(parameter)) == "parameter ann/brain/echo:rate"
    assert ref(parameter) != ref(NODE)
