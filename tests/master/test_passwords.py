"""Which passwords are taken."""

from __future__ import annotations

import hashlib

import pytest

from master.passwords import COMMON, LEAST, check_password
from rce.errors import InvalidRequest


@pytest.mark.parametrize(
    "password", ["correct horse", "canada moose 7", "ünïcödé wörds", "x7#Kp2!qLm", "a" * 20 + "bcd", "robotic arm 7"]
)
def test_good_ones(password: str) -> None:
    check_password(password, "ada")


@pytest.mark.parametrize(
    ("password", "why"),
    [
        ("", "0 characters"),
        ("x7#Kp2!qL", "9 characters"),
        ("xyz1" * 300, "1200 characters"),
        ("qwertyuiop", "everybody tries"),
        ("PassWord1234", "everybody tries"),
        ("aaaaaaaaaaaaaa", "everybody tries"),
        ("alexandria12345", "user's name"),
        ("Alexandria!alexandria", "user's name"),
        (hashlib.sha256(b"x").hexdigest(), "looks like a hash"),
        ("rce_0123456789abcdef", "API key"),
    ],
)
def test_bad_ones(password: str, why: str) -> None:
    with pytest.raises(InvalidRequest, match=why) as raised:
        check_password(password, "alexandria")
    assert raised.value.field == "password"
    assert len(password) < 4 or password not in str(raised.value)


def test_the_list_has_none_that_are_too_short_anyhow() -> None:
    assert min(len(password) for password in COMMON) >= LEAST - 2
    assert all(password == password.casefold() for password in COMMON)
