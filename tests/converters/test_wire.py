"""Blobs of received messages and of messages to send."""

from __future__ import annotations

import pytest

from converters.scalars import FieldError
from converters.wire import Incoming, Outgoing


def test_missing_blob_is_reported() -> None:
    with pytest.raises(FieldError, match="no blob 'two'"):
        Incoming({"one": b""}).get("two")
    with pytest.raises(FieldError) as caught:
        Incoming({}).get("x" * 10_000)
    assert len(caught.value.reason) < 100


def test_unused_blobs_are_reported() -> None:
    blobs = Incoming({"one": b"1", "two": b"2"})
    with pytest.raises(FieldError, match=r"2 blob\(s\) belong to no field"):
        blobs.check_all_used()
    assert blobs.get("one") == blobs.get("one") == b"1"
    with pytest.raises(FieldError, match=r"1 blob\(s\) belong to no field"):
        blobs.check_all_used()
    blobs.get("two")
    blobs.check_all_used()


def test_each_blob_to_send_gets_an_id_of_its_own() -> None:
    blobs = Outgoing()
    ids = [blobs.add(b"same"), blobs.add(b"same")]
    assert list(blobs) == ids
    assert len(set(ids)) == 2
    assert {len(blob_id) for blob_id in ids} == {32}, "the protocol's blobs begin with an id of 32 characters"
