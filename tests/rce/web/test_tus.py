"""Headers of tus."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest
from rce.web import tus
from rce.web.problems import HttpError


def test_version_is_checked_if_it_is_given() -> None:
    tus.check_version({})
    tus.check_version({"Tus-Resumable": "1.0.0"})
    with pytest.raises(HttpError):
        tus.check_version({"Tus-Resumable": "0.2.2"})


def test_type_of_a_chunk_is_checked() -> None:
    tus.check_chunk(tus.CHUNK_TYPE)
    with pytest.raises(HttpError):
        tus.check_chunk("text/plain")


def test_answers_have_the_version() -> None:
    assert tus.answer_headers({"a": "b"}) == {"Tus-Resumable": "1.0.0", "a": "b"}


def test_numbers_and_metadata_are_parsed() -> None:
    assert tus.number("12", "Upload-Length") == 12
    assert tus.metadata("filename YQ==, empty ,mark Yg==") == {"filename": "a", "empty": "", "mark": "b"}


@pytest.mark.parametrize("text", [None, "", "-1", "1.5", "x", "9" * 19, "\u0661"])
def test_other_numbers_are_refused(text: str | None) -> None:
    with pytest.raises(InvalidRequest, match="Upload-Length"):
        tus.number(text, "Upload-Length")


def test_malformed_metadata_is_refused() -> None:
    with pytest.raises(InvalidRequest):
        tus.metadata("filename ???")
