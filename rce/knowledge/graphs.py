"""Named graphs in a triple store, whose default graph has each triple of theirs once.

The union that pyoxigraph can make itself of named graphs has a triple as often as graphs have it, so that counts are
wrong.
"""

from __future__ import annotations

import pyoxigraph
from pyoxigraph import Quad, Store

DEFAULT = pyoxigraph.DefaultGraph()


def set_graph(store: Store, graph: str, triples: bytes) -> None:
    """Set a named graph to triples, which are N-Triples."""
    drop_graph(store, graph)
    name = pyoxigraph.NamedNode(graph)
    parsed = [*pyoxigraph.parse(triples, pyoxigraph.RdfFormat.N_TRIPLES)]
    store.extend(Quad(each.subject, each.predicate, each.object, name) for each in parsed)
    store.extend(Quad(each.subject, each.predicate, each.object) for each in parsed)


def drop_graph(store: Store, graph: str) -> None:
    """Remove a named graph, if it is there."""
    for quad in [*store.quads_for_pattern(None, None, None, pyoxigraph.NamedNode(graph))]:
        store.remove(quad)
        triple = quad.subject, quad.predicate, quad.object
        if all(each.graph_name == DEFAULT for each in store.quads_for_pattern(*triple, None)):
            store.remove(Quad(*triple))
