"""Evaluation of SPARQL queries: the answers of another implementation, and what is refused."""

from __future__ import annotations

import pyoxigraph
import pytest
import rdflib

from rce.errors import InvalidRequest, LimitExceeded
from rce.knowledge.evaluation import check_query, evaluate
from rce.knowledge.graphs import set_graph
from rce.knowledge.reading import read
from tests.support.knowledge import CUP, KITCHEN
from tests.support.knowledge import ontologies as ontology_files

PREFIXES = f"""PREFIX k: <{KITCHEN}> PREFIX rdfs: <http://www.w3.org/2000/01/rdf-schema#>
PREFIX owl: <http://www.w3.org/2002/07/owl#> PREFIX knowrob: <http://ias.cs.tum.edu/kb/knowrob.owl#>
PREFIX roboearth: <http://www.roboearth.org/kb/roboearth.owl#>
"""
QUERIES = (
    "SELECT DISTINCT ?c { ?s a ?c }",
    "SELECT (COUNT(*) AS ?n) { ?s ?p ?o }",
    "SELECT ?c (COUNT(?s) AS ?n) { ?s a ?c } GROUP BY ?c",
    "SELECT ?c (COUNT(?s) AS ?n) { ?s a ?c } GROUP BY ?c HAVING (COUNT(?s) > 5)",
    "SELECT ?s { ?s rdfs:subClassOf* knowrob:Map }",
    "SELECT DISTINCT ?s { ?s a/rdfs:subClassOf* knowrob:Map }",
    "SELECT ?s ?l { ?s a owl:Class OPTIONAL { ?s rdfs:label ?l } FILTER isIRI(?s) }",
    "SELECT ?s { ?s a knowrob:Door } ORDER BY ?s LIMIT 5",
    "SELECT ?s { { ?s a knowrob:Door } UNION { ?s a knowrob:Handle } }",
    "SELECT DISTINCT ?p { ?s ?p ?o FILTER isLiteral(?o) }",
    "SELECT ?s { ?s a owl:Class FILTER NOT EXISTS { ?s rdfs:subClassOf ?x } FILTER isIRI(?s) }",
    "SELECT ?s { ?s a owl:Class MINUS { ?s rdfs:subClassOf ?x } FILTER isIRI(?s) }",
    'SELECT ?s { ?s ?p ?o FILTER (isIRI(?s) && REGEX(STR(?o), "kitchen", "i")) }',
    "SELECT ?s ?w { ?s knowrob:widthOfObject ?w }",
    "SELECT (MAX(STRLEN(STR(?s))) AS ?m) { ?s a owl:Class FILTER isIRI(?s) }",
    "SELECT ?a ?b { ?a knowrob:properPhysicalParts ?b }",
    "SELECT ?s { VALUES ?c { knowrob:Door knowrob:Cupboard } ?s a ?c }",
    "SELECT ?n { ?s a knowrob:Handle BIND (STRAFTER(STR(?s), '#') AS ?n) }",
    "ASK { ?s a knowrob:Cupboard }",
    "CONSTRUCT { ?s a knowrob:Thing } { ?s a knowrob:Door }",
)


def rows(graph: rdflib.Graph, query: str) -> list[tuple[str | None, ...]]:
    """Return the answer of rdflib, as N-Triples."""
    result = graph.query(query)
    if result.type == "CONSTRUCT":
        assert result.graph is not None
        return sorted(tuple(term.n3() for term in triple) for triple in result.graph)
    return sorted(tuple(None if term is None else term.n3() for term in row) for row in result)


@pytest.mark.parametrize("query", QUERIES)
def test_answers_equal_those_of_rdflib(query: str, ontologies: tuple[rdflib.Graph, pyoxigraph.Store]) -> None:
    graph, store = ontologies
    found = evaluate(store, PREFIXES + query, 10_000)
    if query.startswith("ASK"):
        assert found.answer is graph.query(PREFIXES + query).askAnswer is True
        return
    expected = rows(graph, PREFIXES + query)
    assert sorted(map(plain, found.rows)) == sorted(map(plain, expected))
    assert expected, "a query without an answer shows nothing"


def plain(row: list[str | None] | tuple[str | None, ...]) -> tuple[str, ...]:
    """Return a row in which a literal of the type string is written in one way."""
    return tuple((term or "").removesuffix("^^<http://www.w3.org/2001/XMLSchema#string>") for term in row)


@pytest.fixture(scope="module")
def ontologies() -> tuple[rdflib.Graph, pyoxigraph.Store]:
    """Real ontologies, in rdflib and as the repository has them."""
    graph, store = rdflib.Graph(), pyoxigraph.Store()
    for number, file in enumerate(sorted(ontology_files().glob("*.owl"))):
        if file.name != "cabinet_model.owl":
            triples = read("https://rce.invalid/knowledge/object/a.b", file.read_text()).triples
            graph.parse(data=triples, format="nt")
            set_graph(store, f"https://rce.invalid/{number}", triples)
    return graph, store


@pytest.mark.parametrize(
    ("query", "reason"),
    [
        ("SELECT * { SERVICE <http://127.0.0.1/> { ?s ?p ?o } }", "SERVICE is not allowed"),
        ("ASK { { ?s ?p ?o FILTER EXISTS { SERVICE SILENT ?s { ?a ?b ?c } } } }", "SERVICE is not allowed"),
        (
            "SELECT * { { SELECT * { OPTIONAL { SERVICE <http://127.0.0.1/> { ?s ?p ?o } } } } }",
            "SERVICE is not allowed",
        ),
        ("LOAD <http://127.0.0.1/>", "updates, such as LOAD, are not allowed"),
        ("DELETE WHERE { ?s ?p ?o }", "updates"),
        ("SELECT * { ?s ?p ?o } LIMIT", "line 1, column 23"),
        ("SELECT * " + "{" * 5000, "nested"),
    ],
)
def test_other_servers_updates_and_malformed_queries_are_refused(query: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        check_query(query)


def test_data_of_other_servers_is_not_fetched() -> None:
    """FROM names a graph of the repository, whether there is one or not."""
    found = evaluate(pyoxigraph.Store(), "SELECT * FROM <http://127.0.0.1:1/> { ?s ?p ?o }", 10)
    assert found.rows == []


def test_answer_is_bounded() -> None:
    store = pyoxigraph.Store()
    store.load(read("http://a/", CUP).triples, pyoxigraph.RdfFormat.N_TRIPLES)
    with pytest.raises(LimitExceeded, match="more than 4 rows"):
        evaluate(store, "SELECT * { ?s ?p ?o }", 4)
    assert len(evaluate(store, "SELECT * { ?s ?p ?o }", 5).rows) == 5
