"""Passwords: how they are kept, and which are good enough (NIST SP 800-63B: length, and not what everybody tries).

A password is stored as argon2 of its SHA-256 hex, since that is what robots send. An argon2 check is slow on purpose,
and few run at once.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import argon2

from master.grants import KEY_PREFIX, digest
from rce.errors import InvalidRequest

CHECKS_AT_ONCE = 2
LEAST, MOST = 10, 1000  # characters
LEFT = 6  # characters that must remain beside the user's name
HASH = re.compile(r"[0-9a-fA-F]{64}", re.ASCII)
_DECOY = "$argon2id$v=19$m=19456,t=2,p=1$MDEyMzQ1Njc4OWFiY2RlZg$1tTS0Sl0WxSQqvnBzLCbWa2CKYGFyN8s0mN0Pa6yjgk"
# Those of ten characters and more that lists of broken passwords have most often; the shorter ones are refused anyhow.
COMMON = frozenset(
    """
    1234567890 0123456789 0987654321 1234567891 12345678910 123456789a 1q2w3e4r5t 1qaz2wsx3edc q1w2e3r4t5 qwertyuiop
    qwerty1234 qwerty12345 qwerty123456 asdfghjkl1 asdfghjkl; zxcvbnm123 password12 password123 password1234
    passw0rd123 password!! mypassword newpassword changeme123 changeme1234 administrator administrateur adminadmin
    admin12345 admin123456 letmein123 letmein1234 welcome123 welcome1234 iloveyou123 iloveyou12 sunshine123
    princess123 football123 baseball123 basketball superman123 spiderman1 pokemon123 liverpool1 manchester chelsea123
    motherfucker fuckyou123 trustno1trustno1 correcthorsebatterystaple rootroot123 robotrobot raspberry1 raspberrypi
    ubuntu1234 abcdefghij abcdefghijk abc1234567 abcd123456 abcd1234567 a123456789 aa123456789 qazwsxedcr qazwsxedcrfv
    11223344556677 1122334455 9876543210 98765432100 5555555555 1029384756 3141592653 31415926535 computer123
    internet123 michael123 jennifer123 testtest123 testtest12 test123456 test1234567 testuser123 guest12345 default123
    secret1234 secret12345
    """.split()  # noqa: SIM905  # one can read it
)


class Passwords:
    """Hashes, and checks a few at a time."""

    def __init__(self) -> None:
        self.hasher = argon2.PasswordHasher(time_cost=2, memory_cost=19_456, parallelism=1)  # OWASP's minimum
        self._checks = asyncio.Semaphore(CHECKS_AT_ONCE)

    async def hash(self, password: str) -> str:
        return await asyncio.to_thread(self.hasher.hash, digest(password))

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Wait until it is one's turn to check."""
        async with self._checks:
            yield

    async def verify(self, hashed: str | None, secret: str) -> bool:
        """Whether `secret`, the SHA-256 hex, is right; without a hash (no such user) it takes as long to say no."""
        good = await asyncio.to_thread(self._verify, hashed or _DECOY, secret.lower())
        return good and hashed is not None

    def _verify(self, hashed: str, secret: str) -> bool:
        try:
            return self.hasher.verify(hashed, secret)
        except argon2.exceptions.VerificationError:
            return False


def check_password(password: str, user: str) -> None:
    """Whether it is good enough for a new password of this user. InvalidRequest says why not."""
    reason = _fault(password, user)
    if reason:
        raise InvalidRequest(f"this password is not taken: {reason}", field="password")


def _fault(password: str, user: str) -> str:
    plain = password.casefold()
    if not LEAST <= len(password) <= MOST:
        return f"it has {len(password)} characters; at least {LEAST} are needed (a few words will do), at most {MOST}"
    if HASH.fullmatch(password) or password.startswith(KEY_PREFIX):
        return "it looks like a hash or an API key, and would be taken for one"
    if plain in COMMON or len(set(plain)) < 4:
        return "it is among the first that everybody tries"
    if len(plain.replace(user.casefold(), "")) < LEFT:
        return "it is hardly more than the user's name"
    return ""
