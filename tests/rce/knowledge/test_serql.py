"""Translation of SeRQL."""

from __future__ import annotations

import pyoxigraph
import pytest

from rce.errors import InvalidRequest
from rce.knowledge.evaluation import check_query, evaluate
from rce.knowledge.graphs import set_graph
from rce.knowledge.reading import read
from rce.knowledge.serql import translate
from tests.support.knowledge import CUP

GRAPH = "https://rce.invalid/knowledge/object/cup.blue"
USING = " USING NAMESPACE k = <http://example.org/kitchen.owl#>"


@pytest.fixture
def store() -> pyoxigraph.Store:
    store = pyoxigraph.Store()
    set_graph(store, GRAPH, read(GRAPH, CUP).triples)
    return store


@pytest.mark.parametrize(
    ("query", "rows"),
    [
        ("SELECT source FROM CONTEXT source {S} rdf:type {k:Cup}", [[f"<{GRAPH}>"]]),
        ("select distinct S from {S} rdf:type {<http://example.org/kitchen.owl#Cup>}", [["<{k}cup1>"]]),
        ("SELECT S FROM {S} <!http://www.w3.org/1999/02/22-rdf-syntax-ns#type> {k:Cup}", [["<{k}cup1>"]]),
        ("SELECT S FROM {S} rdf:type {} rdfs:subClassOf {k:Vessel}", [["<{k}cup1>"]]),
        ("SELECT S, L FROM {S} rdf:type {k:Cup}; rdfs:label {L}", [["<{k}cup1>", '"the blue cup"']]),
        ("SELECT A FROM {A} rdfs:subClassOf {B}, {B} rdfs:subClassOf {C}", [["<{k}Cup>"]]),
        ('SELECT S FROM {S} rdfs:label {L} WHERE L LIKE "*BLUE*" IGNORE CASE', [["<{k}cup1>"]]),
        ('SELECT S FROM {S} rdfs:label {L} WHERE L LIKE "blue*"', []),
        ("SELECT S FROM {S} k:height {H} WHERE (H > 0.05 AND H < 0.2) OR H = 7", [["<{k}cup1>"]]),
        ("SELECT * FROM {S} rdfs:subClassOf {k:Thing} LIMIT 1 OFFSET 0", [["<{k}Vessel>"]]),
    ],
)
def test_shape_of_original_clients_is_translated(store: pyoxigraph.Store, query: str, rows: list[list[str]]) -> None:
    expected = [[value.replace("{k}", "http://example.org/kitchen.owl#") for value in row] for row in rows]
    assert evaluate(store, translate(query + USING), 10).rows == expected


@pytest.mark.parametrize(
    "query",
    [
        "",
        "CONSTRUCT * FROM {S} p {O}",
        "SELECT S",
        "SELECT S FROM {S}",
        "SELECT S FROM {S} rdf:type {O} WHERE",
        "SELECT S FROM {S} rdf:type {O} WHERE S LIKE 3",
        "SELECT S FROM {S} rdf:type {O} MINUS SELECT",
        "SELECT S FROM {S} rdf:type {O} USING NAMESPACE k",
        "SELECT S FROM {S} rdf:type {O} } ; DROP ALL",
        "SELECT WHERE FROM {S} rdf:type {O}",
        pytest.param("SELECT S FROM {S} rdf:type {O} WHERE " + "(" * 5000, id="deep"),
    ],
)
def test_other_shapes_are_refused_with_a_hint_at_sparql(query: str) -> None:
    with pytest.raises(InvalidRequest, match="use SPARQL"):
        translate(query)


def test_text_cannot_leave_its_place() -> None:
    """The text of a literal is not translated."""
    found = translate(r'SELECT S FROM {S} rdfs:label {"a\" } SERVICE <http://x> {"}')
    assert found.count("SERVICE") == 1
    assert r'"a\" } SERVICE <http://x> {"' in found


def test_pattern_is_the_text_of_its_literal() -> None:
    found = translate(r'SELECT S FROM {S} rdfs:label {L} WHERE L LIKE "a\".b*"@en')
    assert r'"^a\"\\.b.*$"' in found
    check_query(found)
