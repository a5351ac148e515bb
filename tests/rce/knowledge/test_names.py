"""Names of entries, graphs and files."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest, NotFound
from rce.knowledge.names import check_file_name, check_kind, graph_of, local_name, make_uid


def test_uid_is_class_and_name_in_lower_case_without_blanks() -> None:
    assert make_uid("Tea Cup", "Blue 1.b") == "teacup.blue1.b"
    for cls, name in ((" ", "a"), ("a", " "), ("a", "b.")):
        with pytest.raises(InvalidRequest):
            make_uid(cls, name)


def test_graph_of_an_entry_is_an_iri_below_which_relative_ones_are() -> None:
    assert graph_of("object", "cup.blue") == "https://rce.invalid/knowledge/object/cup.blue"


def test_local_name_is_the_last_part() -> None:
    for iri in ("http://a/b#Cup", "http://a/Cup", "urn:x:Cup", "Cup"):
        assert local_name(iri) == "cup"


def test_unknown_kind_and_unsafe_file_are_refused() -> None:
    assert check_kind("recipe") == "recipe"
    assert check_file_name("map.pgm") == "map.pgm"
    with pytest.raises(NotFound, match="recipe, object, environment"):
        check_kind("robot")
    for name in ("", "../a", ".a", "a/b", "a\n"):
        with pytest.raises(InvalidRequest):
            check_file_name(name)
