"""Rules for new passwords, and how verified ones are remembered."""

from __future__ import annotations

import hashlib

import pytest

from master.access import passwords
from master.access.grants import digest
from master.access.passwords import COMMON, MIN_LENGTH, REMEMBER, Passwords, check_password
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


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


async def test_verified_password_is_remembered_for_a_while() -> None:
    clock = Clock()
    place = Passwords(clock)
    hashed, secret = await place.hash("canada moose 7"), digest("canada moose 7")
    assert not place.was_verified(hashed, secret)
    assert await place.verify(hashed, secret.upper())
    assert place.was_verified(hashed, secret)
    clock.now = REMEMBER
    assert not place.was_verified(hashed, secret)


async def test_wrong_password_is_not_remembered() -> None:
    place = Passwords()
    hashed, wrong = await place.hash("canada moose 7"), digest("another password")
    assert not await place.verify(hashed, wrong)
    assert not await place.verify(None, wrong)
    assert not place.was_verified(hashed, wrong)


async def test_changed_hash_is_not_the_verified_one() -> None:
    place = Passwords()
    hashed, secret = await place.hash("canada moose 7"), digest("canada moose 7")
    await place.verify(hashed, secret)
    assert not place.was_verified(await place.hash("canada moose 7"), secret)


async def test_number_of_remembered_passwords_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passwords, "MAX_REMEMBERED", 1)
    place = Passwords()
    secret = digest("canada moose 7")
    first, second = await place.hash("canada moose 7"), await place.hash("canada moose 7")
    await place.verify(first, secret)
    await place.verify(second, secret)
    assert not place.was_verified(first, secret)
    assert place.was_verified(second, secret)
