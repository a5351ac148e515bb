"""Calls of services, such as the map service, to the Master: to authenticate clients and to act on their behalf."""

from __future__ import annotations

from msgspec import Struct

from rce.control.calls.call import Call, Nothing


class Identity(Struct, frozen=True):
    """Authenticated user.

    `key` is the id of the API key, or empty after authentication with a password. `reach` is that of the operation:
    `own` things, or `all` users' things.
    """

    user: str
    role: str
    key: str = ""
    reach: str = "own"


class Authenticate(Call[Identity], frozen=True):
    """Authenticate a client of a service and authorize an operation. With an API key, `user` may be empty.

    Raises Unauthorized, TooManyAttempts, Forbidden.
    """

    user: str
    secret: str  # API key, or SHA-256 hex of the password
    operation: str = "job.submit"  # or another of the service
    address: str = ""  # of the client


class RecordAction(Call[Nothing], frozen=True):
    """Record an operation of a client, successful or not, in the audit log."""

    identity: Identity
    action: str  # as job.cancel
    object: str  # as user/ID
    result: str  # ok, or an error code
    address: str = ""  # of the client


class Grant(Struct, frozen=True):
    """Right of one service to act for one user. The name of a grant is no secret: only its service can use it."""

    grant: str


class CreateGrant(Call[Grant], frozen=True):
    """Give the service the right to act for a client.

    It lasts until `RevokeGrant`, or until the user or the API key is removed.
    """

    user: str
    secret: str
    address: str = ""


class TemporaryKey(Struct, frozen=True):
    """API key with which a service connects as a robot of this user."""

    user: str
    key: str


class IssueKey(Call[TemporaryKey], frozen=True):
    """Issue a new key for a grant; its earlier key becomes invalid. Raises Unauthorized."""

    grant: str
    seconds: float  # until it expires


class RevokeGrant(Call[Nothing], frozen=True):
    """Revoke a grant and its key."""

    grant: str


class InvalidateAuthentication(Call[Nothing], frozen=True):
    """Tell a service to authenticate this user again, because the user's credentials or rights have changed."""

    user: str
