"""Rules for new passwords."""

from __future__ import annotations

import hashlib

import pytest

from master.access.passwords import COMMON, MIN_LENGTH, check_password
from rce.errors import InvalidRequest


@pytest.mark.parametrize(
    "password", ["correct horse", "canada moose 7", "ünïcödé wörds", "x7#Kp2!qLm", "a" * 20 + "bcd", "robotic arm 7"]
)
def test_strong_passwords_are_accepted(password: str) -> None:
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
def test_weak_passwords_are_refused(password: str, why: str) -> None:
    with pytest.raises(InvalidRequest, match=why) as raised:
        check_password(password, "alexandria")
    assert raised.value.field == "password"
    assert len(password) < 4 or password not in str(raised.value)


def test_list_of_common_passwords_has_no_short_ones() -> None:
    assert min(len(password) for password in COMMON) >= MIN_LENGTH - 2
    assert all(password == password.casefold() for password in COMMON)
