"""Reading of OWL texts with rdflib, in a process of its own.

rdflib reads what pyoxigraph refuses, such as entities in single quotes; its triples go on as N-Triples.
"""

from __future__ import annotations

import logging
import re

import pyoxigraph
import rdflib
from rdflib.namespace import OWL, RDF, RDFS
from rdflib.plugins.parsers.notation3 import BadSyntax

from rce.errors import InvalidRequest, RceError
from rce.knowledge.markup import check_markup
from rce.knowledge.messages import Reading

MAX_TRIPLES = 200_000
MAX_WORDS = 40_000  # characters
XML = re.compile(r"\s*<(\?xml|!|[\w.-]+:RDF\b|RDF\b)")
VOCABULARY = (str(OWL), str(RDF), str(RDFS))

logging.getLogger("rdflib").setLevel(logging.CRITICAL)  # what it warns of is refused below


def read(base: str, text: str) -> Reading:
    """Return the content of RDF/XML or Turtle; an empty text has none.

    Raises:
        InvalidRequest: The text is malformed, or has more than it may.
    """
    if not text.strip():
        return Reading()
    graph = rdflib.Graph()
    is_xml = XML.match(text) is not None
    if is_xml:
        check_markup(text)
    try:
        graph.parse(data=text, format="xml" if is_xml else "turtle", publicID=base)
    except RceError:
        raise
    except BadSyntax as error:
        raise _refused(f"line {error.lines + 1}: {error._why}") from None
    except (MemoryError, RecursionError):
        raise
    except Exception as error:  # noqa: BLE001  # rdflib's parsers raise what they happen to meet
        raise _refused(str(error) or type(error).__name__) from None
    if len(graph) > MAX_TRIPLES:
        raise _refused(f"it has {len(graph)} triples; an entry may have {MAX_TRIPLES}")
    triples = _serialized(graph)
    subclasses = [(str(low), str(high)) for low, high in graph.subject_objects(RDFS.subClassOf) if _both(low, high)]
    types = {str(each) for each in graph.objects(None, RDF.type) if isinstance(each, rdflib.URIRef)}
    types |= {low for low, _ in subclasses}
    own = sorted(each for each in types if not each.startswith(VOCABULARY))
    return Reading(triples, len(graph), own, sorted(set(subclasses)), _words(graph))


def _serialized(graph: rdflib.Graph) -> bytes:
    """Return the triples as N-Triples that pyoxigraph takes, too."""
    try:
        triples = graph.serialize(format="nt", encoding="utf-8")
        for _ in pyoxigraph.parse(triples, pyoxigraph.RdfFormat.N_TRIPLES):
            pass
    except (MemoryError, RecursionError):
        raise
    except Exception as error:  # noqa: BLE001  # rdflib raises plain ones
        raise _refused(f"it has an invalid IRI or literal: {error}") from None
    return triples


def _both(*terms: object) -> bool:
    return all(isinstance(term, rdflib.URIRef) for term in terms)


def _words(graph: rdflib.Graph) -> str:
    """Return the words by which a text is found: what it says of its things, and their names."""
    texts = [str(each) for name in (RDFS.label, RDFS.comment) for each in graph.objects(None, name)]
    names = {re.split("[#/]", str(each))[-1] for each in graph.subjects() if isinstance(each, rdflib.URIRef)}
    return " ".join([*texts, *sorted(names)])[:MAX_WORDS]


def _refused(reason: str) -> InvalidRequest:
    return InvalidRequest(f"the OWL text is refused: {reason[:1000]}", field="owl")
