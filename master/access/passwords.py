"""Passwords: their hashes, and rules for new ones (NIST SP 800-63B: length, and no common passwords).

The database has argon2 of the SHA-256 hex, because robots send the latter. An argon2 check is slow on purpose, so only
a few run at once.
"""

from __future__ import annotations

import asyncio
import hashlib
import re
import secrets
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import argon2

from master.access.grants import KEY_PREFIX, digest
from rce.errors import InvalidRequest

MAX_CHECKS = 2
MIN_LENGTH, MAX_LENGTH = 10, 1000  # characters
MIN_BESIDE_NAME = 6  # characters beside the user's name
REMEMBER = 600.0  # seconds for which a verified password need not be hashed again
MAX_REMEMBERED = 20_000  # passwords; the oldest are forgotten first
HASH = re.compile(r"[0-9a-fA-F]{64}", re.ASCII)
_DECOY = "$argon2id$v=19$m=19456,t=2,p=1$MDEyMzQ1Njc4OWFiY2RlZg$1tTS0Sl0WxSQqvnBzLCbWa2CKYGFyN8s0mN0Pa6yjgk"
# The most frequent passwords of ten and more characters in lists of broken ones; shorter ones are refused anyway.
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
    """.split()  # noqa: SIM905  # readable
)


class Passwords:
    """Makes and verifies hashes, a few at a time. `now` is the clock by which verified passwords are forgotten.

    A fleet of robots logs in again after each restart of a Robot endpoint, so a password that was just verified is
    accepted without argon2. What is remembered of it is a digest under a key that this process alone has. The digest
    covers the hash in the database, so a changed password is forgotten at once.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.hasher = argon2.PasswordHasher(time_cost=2, memory_cost=19_456, parallelism=1)  # OWASP's minimum
        self._checks = asyncio.Semaphore(MAX_CHECKS)
        self._now = now
        self._key = secrets.token_bytes(32)
        self._verified: OrderedDict[bytes, float] = OrderedDict()  # digest -> when it is forgotten

    async def hash(self, password: str) -> str:
        """Return the hash of a password, in a thread."""
        return await asyncio.to_thread(self.hasher.hash, digest(password))

    @asynccontextmanager
    async def slot(self) -> AsyncIterator[None]:
        """Limit the number of concurrent checks."""
        async with self._checks:
            yield

    async def verify(self, hashed: str | None, secret: str) -> bool:
        """Return whether `secret`, the SHA-256 hex, matches. Without a hash it takes as long to fail."""
        good = await asyncio.to_thread(self._verify, hashed or _DECOY, secret.lower())
        if not good or hashed is None:
            return False
        self._remember(self._digest(hashed, secret))
        return True

    def was_verified(self, hashed: str, secret: str) -> bool:
        """Return whether `verify` accepted the same arguments a short while ago."""
        return self._verified.get(self._digest(hashed, secret), 0.0) > self._now()

    def _remember(self, digest: bytes) -> None:
        self._verified[digest] = self._now() + REMEMBER
        self._verified.move_to_end(digest)
        while len(self._verified) > MAX_REMEMBERED or next(iter(self._verified.values())) <= self._now():
            self._verified.popitem(last=False)

    def _digest(self, hashed: str, secret: str) -> bytes:
        return hashlib.blake2b(f"{hashed} {secret.lower()}".encode(), key=self._key, digest_size=32).digest()

    def _verify(self, hashed: str, secret: str) -> bool:
        try:
            return self.hasher.verify(hashed, secret)
        except argon2.exceptions.VerificationError:
            return False


def check_password(password: str, user: str) -> None:
    """Check a new password of a user.

    Raises:
        InvalidRequest: It is too weak; the error says why.
    """
    reason = _fault(password, user)
    if reason:
        raise InvalidRequest(f"this password is not taken: {reason}", field="password")


def _fault(password: str, user: str) -> str:
    plain = password.casefold()
    if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
        few = f"at least {MIN_LENGTH} are needed (a few words will do), at most {MAX_LENGTH}"
        return f"it has {len(password)} characters; {few}"
    if HASH.fullmatch(password) or password.startswith(KEY_PREFIX):
        return "it looks like a hash or an API key, and would be taken for one"
    if plain in COMMON or len(set(plain)) < 4:
        return "it is among the first that everybody tries"
    if len(plain.replace(user.casefold(), "")) < MIN_BESIDE_NAME:
        return "it is hardly more than the user's name"
    return ""
