"""Reading of OWL texts; real ontologies, where they are."""

from __future__ import annotations

import pytest
import rdflib

from rce.errors import InvalidRequest
from rce.knowledge import reading
from rce.knowledge.messages import Reading
from rce.knowledge.reading import read
from tests.support.knowledge import BED, CUP, KITCHEN, ontologies

BASE = "https://rce.invalid/knowledge/object/a.b"


def test_turtle_and_xml_are_read() -> None:
    cup, bed = read(BASE, CUP), read(BASE, BED)
    assert (cup.count, bed.count) == (5, 1)
    assert cup.types == [KITCHEN + "Cup", KITCHEN + "Vessel"]
    assert (KITCHEN + "Cup", KITCHEN + "Vessel") in cup.subclasses
    assert "the blue cup" in cup.words
    assert "bed1" in bed.words
    assert read(BASE, " \n") == Reading()


def test_relative_names_refer_to_the_entry() -> None:
    assert f"<{BASE}#x>".encode() in read(BASE, "<#x> a <#Y> .").triples


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("@prefix a: <b> .\nx y z .", "line 2"),
        ("<rdf:RDF", "line 1"),
        ("<http://a b> a <http://c> .", "refused"),
        ("words", "line 1"),
        ('<?xml version="1.0"?><rdf:RDF/>\n', "line 1"),
    ],
)
def test_malformed_text_is_refused(text: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        read(BASE, text)


def test_number_of_triples_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MAX_TRIPLES", 2)
    with pytest.raises(InvalidRequest, match="it has 5 triples; an entry may have 2"):
        read(BASE, CUP)


def test_real_ontologies_are_read_as_rdflib_does_and_the_broken_one_is_refused() -> None:
    files = sorted(ontologies().glob("*.owl"))
    for file in files:
        if file.name == "cabinet_model.owl":
            with pytest.raises(InvalidRequest, match="line 38, column 6: mismatched tag"):
                read(BASE, file.read_text())
            continue
        found = read(BASE, file.read_text())
        assert found.count == len(rdflib.Graph().parse(file, format="xml")), file.name
    assert len(files) == 14
