"""Join codes."""

from __future__ import annotations

import pytest

from rce.api.joining import Invitation, JoinCode, parse_join_code, process_name
from rce.errors import InvalidRequest

INVITATION = Invitation("beta", ["robot", "container"], 2_000_000_000, "secret", "10.0.0.2")


def test_join_code_round_trips_as_text() -> None:
    code = JoinCode("https://10.0.0.1:8081/", "ab" * 32, INVITATION)
    text = code.text()
    assert text.startswith("rce1-")
    assert set(text) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_")
    assert parse_join_code(f"  {text}\n") == code


@pytest.mark.parametrize("text", ["", "nonsense", "rce1-", "rce1-e30", "rce1-ÿ"])
def test_malformed_join_code_is_rejected(text: str) -> None:
    with pytest.raises(InvalidRequest, match="join code"):
        parse_join_code(text)


def test_truncated_join_code_is_rejected() -> None:
    with pytest.raises(InvalidRequest):
        parse_join_code(JoinCode("https://x/", "ab", INVITATION).text()[:-10])


def test_digest_covers_all_fields() -> None:
    others = [
        Invitation("gamma", ["robot", "container"], 2_000_000_000, "secret", "10.0.0.2"),
        Invitation("beta", ["robot"], 2_000_000_000, "secret", "10.0.0.2"),
        Invitation("beta", ["robot", "container"], 2_000_000_001, "secret", "10.0.0.2"),
        Invitation("beta", ["robot", "container"], 2_000_000_000, "secret", "10.0.0.3"),
    ]
    assert len({each.digest for each in [INVITATION, *others]}) == 5


def test_process_names_of_a_machine_are_distinct() -> None:
    assert [process_name("beta", role) for role in ("container", "robot")] == ["beta", "beta-robot"]
