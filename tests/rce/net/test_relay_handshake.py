"""First line of a caller of a data relay, and refusals."""

from __future__ import annotations

from typing import get_args

import pytest

from rce.errors import InvalidRequest
from rce.net.relay_handshake import (
    GREETING_SIZE,
    RefusalReason,
    RelayRequest,
    encode_refusal,
    parse_relay_address,
    refusal_reason,
)


def test_request_round_trip() -> None:
    request = RelayRequest("ann/brain", "10.0.0.1:9030", "ann")
    assert request.line().endswith(b"\n")
    assert RelayRequest.parse(request.line()) == request


@pytest.mark.parametrize(
    "line", [b"\n", b"{}\n", b"GET / HTTP/1.1\r\n", b'{"to": 1}\n', b'{"to": "\xff"}\n', b"[" * 2000]
)
def test_malformed_request_is_refused(line: bytes) -> None:
    with pytest.raises(InvalidRequest, match="first line"):
        RelayRequest.parse(line)


@pytest.mark.parametrize("reason", get_args(RefusalReason))
def test_refusal_is_as_long_as_a_greeting(reason: RefusalReason) -> None:
    refusal = encode_refusal(reason)
    assert len(refusal) == GREETING_SIZE
    assert refusal_reason(refusal) == reason


def test_greeting_of_an_endpoint_is_not_a_refusal() -> None:
    assert refusal_reason(bytes(GREETING_SIZE)) == ""


def test_relay_address() -> None:
    assert parse_relay_address("10.0.0.1:9030/ann/brain") == RelayRequest("ann/brain", "10.0.0.1:9030")
    with pytest.raises(ValueError, match="names no environment"):
        parse_relay_address("10.0.0.1:9030")
