"""What services such as the map service ask of the Master, to know their clients and to act for them."""

from __future__ import annotations

from msgspec import Struct

from rce.calls.call import Call, Nothing


class Person(Struct, frozen=True):
    """Who has proved to be a user, by an API key with this id or by a password."""

    user: str
    role: str
    key: str = ""


class Vouch(Call[Person], frozen=True):
    """A service asks who its client is, and whether they may. With an API key the user may be left out.

    Unauthorized, TooManyAttempts, Forbidden.
    """

    user: str
    secret: str  # API key, or SHA-256 hex of the password
    operation: str = "job.submit"  # or job.read
    address: str = ""  # of the client


class NoteDone(Call[Nothing], frozen=True):
    """A service tells what a client did with what it keeps for them, or could not do: for the audit log."""

    person: Person
    action: str  # as job.cancel
    object: str  # as user/ID
    result: str  # ok, or the code of the error
    address: str = ""  # of the client


class Grant(Struct, frozen=True):
    """The right of one service to act for one user, by name: the name alone opens nothing."""

    grant: str


class Delegate(Call[Grant], frozen=True):
    """A service asks to act for a client later: until it says `EndGrant`, or the user or the API key is gone."""

    user: str
    secret: str
    address: str = ""


class LentKey(Struct, frozen=True):
    """A key with which the service connects as a robot of this user."""

    user: str
    key: str


class Borrow(Call[LentKey], frozen=True):
    """The service that holds a grant takes a new key for it; the one before is void. Unauthorized."""

    grant: str
    seconds: float  # until it expires


class EndGrant(Call[Nothing], frozen=True):
    """The grant and its key are void from now on."""

    grant: str


class ForgetProofs(Call[Nothing], frozen=True):
    """To a service: what this user has proved to it may not hold any more, and is to be proved again."""

    user: str
