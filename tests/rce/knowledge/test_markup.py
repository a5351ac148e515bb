"""XML that is refused before it is parsed as RDF."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest
from rce.knowledge import markup
from rce.knowledge.markup import check_markup


def test_entities_with_a_text_are_allowed() -> None:
    check_markup('<!DOCTYPE a [ <!ENTITY k "http://x#"> ]><a b="&k;c">&amp;</a>')


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('<!DOCTYPE a SYSTEM "http://127.0.0.1/a.dtd"><a/>', "a DTD from elsewhere"),
        ('<!DOCTYPE a PUBLIC "-//x" "a.dtd"><a/>', "a DTD from elsewhere"),
        ('<!DOCTYPE a [ <!ENTITY b SYSTEM "file:///etc/passwd"> ]><a>&b;</a>', "the entity b from elsewhere"),
        ('<!DOCTYPE a [ <!ENTITY % b "c"> ]><a/>', "parameter entity"),
        ('<!DOCTYPE a [ <!ENTITY b "c"><!ENTITY d "&b;&b;"> ]><a>&d;</a>', "refers to another one"),
        ('<!DOCTYPE a [ <!ATTLIST a b CDATA "c"> ]><a/>', "only entities"),
        ("<a>\n<b>\n</a>", "line 3, column 2: mismatched tag"),
        ("", "no element found"),
        ("<a>" * 300, "nested"),
        (f'<!DOCTYPE a [ <!ENTITY b "{"x" * 20_000}"> ]><a>{"&b;" * 1000}</a>', "expand"),
        ("<!DOCTYPE a [ " + "".join(f'<!ENTITY b{n} "c">' for n in range(300)) + " ]><a/>", "more than 200 entities"),
    ],
)
def test_dangerous_or_malformed_xml_is_refused_with_line_and_reason(text: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason) as caught:
        check_markup(text)
    assert str(caught.value).startswith("line ")
    assert caught.value.info.field == "owl"


def test_number_of_elements_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(markup, "MAX_ELEMENTS", 3)
    check_markup("<a><b/><c/></a>")
    with pytest.raises(InvalidRequest, match="more than 3 elements"):
        check_markup("<a><b/><c/><d/></a>")
