"""Named graphs in a triple store."""

from __future__ import annotations

from pyoxigraph import DefaultGraph, Store

from rce.knowledge.graphs import drop_graph, set_graph

ONE, TWO = (f"<http://a> <http://b> <http://{name}> .\n".encode() for name in ("c", "d"))


def default(store: Store) -> int:
    return len([*store.quads_for_pattern(None, None, None, DefaultGraph())])


def test_default_graph_has_each_triple_once_as_long_as_a_graph_has_it() -> None:
    store = Store()
    set_graph(store, "http://x", ONE + TWO)
    set_graph(store, "http://y", ONE)
    assert (default(store), len(store)) == (2, 5)
    set_graph(store, "http://x", TWO)
    assert (default(store), len(store)) == (2, 4)
    drop_graph(store, "http://y")
    drop_graph(store, "http://nothing")
    assert (default(store), len(store)) == (1, 2)


def test_blank_nodes_of_the_default_graph_are_those_of_the_named_one() -> None:
    store = Store()
    set_graph(store, "http://x", b"_:n1 <http://b> _:n2 .\n")
    assert store.query("ASK { ?s ?p ?o GRAPH ?g { ?s ?p ?o } }")
