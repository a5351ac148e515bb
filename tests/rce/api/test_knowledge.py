"""Types of the knowledge service's API."""

from __future__ import annotations

import msgspec
import pytest

from rce.api.knowledge import EntryChange, NewEntry


def test_class_has_its_name_in_json() -> None:
    entry = msgspec.json.decode(b'{"kind": "recipe", "class": "Serve", "id": "Drink"}', type=NewEntry)
    assert (entry.cls, entry.public, entry.shared) == ("Serve", False, [])


def test_change_without_fields_changes_nothing() -> None:
    assert msgspec.json.encode(EntryChange()) == b"{}"
    assert msgspec.json.decode(b'{"location": null}', type=EntryChange).location is None


@pytest.mark.parametrize(
    "fields",
    [
        '"class": "a.b", "id": "c"',
        '"class": "a", "id": "c/d"',
        '"class": "a", "id": "c\\n"',
        '"class": "a", "id": "c", "location": {"latitude": 91, "longitude": 0}',
        '"class": "a", "id": "c", "more": 1',
    ],
)
def test_malformed_entry_is_refused(fields: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(f'{{"kind": "object", {fields}}}', type=NewEntry)
