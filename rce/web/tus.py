"""Resumable uploads by tus 1.0 (https://tus.io/protocols/resumable-upload): headers of requests and answers."""

from __future__ import annotations

import base64
from collections.abc import Mapping

from rce.errors import InvalidRequest
from rce.web.problems import HttpError

VERSION = "1.0.0"
CHUNK_TYPE = "application/offset+octet-stream"
WRONG_TYPE, WRONG_VERSION = 415, 412


def answer_headers(headers: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return headers of an answer, with the version."""
    return {"Tus-Resumable": VERSION, **(headers or {})}


def check_version(headers: Mapping[str, str]) -> None:
    """Check the version of a request; clients without tus, such as curl, do not send one.

    Raises:
        HttpError: It is another one.
    """
    if headers.get("Tus-Resumable", VERSION) != VERSION:
        raise HttpError(f"only tus {VERSION} is supported", status=WRONG_VERSION, field="Tus-Resumable")


def check_chunk(content_type: str) -> None:
    """Check the type of the body of a request that appends.

    Raises:
        HttpError: It is another one.
    """
    if content_type != CHUNK_TYPE:
        raise HttpError(f"the Content-Type must be {CHUNK_TYPE}", status=WRONG_TYPE, field="Content-Type")


def number(text: str | None, field: str) -> int:
    """Return the number of bytes in the header `field`.

    Raises:
        InvalidRequest: It is missing or malformed.
    """
    if text is None or not text.isascii() or not text.isdigit() or len(text) > 18:
        raise InvalidRequest(f"the header {field} must be given, as a number of bytes", field=field)
    return int(text)


def metadata(text: str) -> dict[str, str]:
    """Parse the header Upload-Metadata: `key base64,key base64`.

    Raises:
        InvalidRequest: It is malformed.
    """
    found = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        key, _, value = pair.partition(" ")
        try:
            found[key] = base64.b64decode(value, validate=True).decode()
        except ValueError:
            raise InvalidRequest(f"{key[:60]!r} is not followed by base64", field="Upload-Metadata") from None
    return found
