"""Errors that people and programs can act on.

Every error has a `code` that programs test, a sentence that says what is wrong, where, and what to do, and `fields`
with the particulars. They cross process boundaries as `ErrorInfo` and come out as the same class on the other side; a
code that this version does not know comes out as plain `RceError` with the code kept.
"""

from __future__ import annotations

import errno
import os
from typing import ClassVar

import msgspec

type_of_code: dict[str, type[RceError]] = {}


class ErrorInfo(msgspec.Struct, frozen=True, omit_defaults=True):
    """An error on the wire: `item` is `list[index]` of the command's item, `field` the path of the field at fault."""

    code: str
    message: str
    item: str = ""
    field: str = ""
    fields: dict[str, str | int | float | bool | list[str]] = {}


class RceError(Exception):
    """Base of all errors. Catch it to catch everything that RCE raises on purpose."""

    code: ClassVar[str] = "error"

    def __init__(
        self, message: str, *, item: str = "", field: str = "", **fields: str | int | float | bool | list[str]
    ) -> None:
        super().__init__(message)
        self.info = ErrorInfo(self.code, message, item, field, fields)

    def __init_subclass__(cls) -> None:
        type_of_code.setdefault(cls.code, cls)  # one that is derived without a code of its own crosses as its base

    def __str__(self) -> str:
        return self.info.message

    @property
    def item(self) -> str:
        return self.info.item

    @property
    def field(self) -> str:
        return self.info.field

    @staticmethod
    def from_info(info: ErrorInfo) -> RceError:
        error = type_of_code.get(info.code, RceError)(info.message)
        error.info = info
        return error

    def at(self, item: str) -> RceError:
        """The same error, with the place in the command where it happened (`addNodes[2]`)."""
        self.info = msgspec.structs.replace(self.info, item=item)
        return self

    def about(self, **fields: str | int | float | bool | list[str]) -> RceError:
        """The same error, with more particulars."""
        self.info = msgspec.structs.replace(self.info, fields=self.info.fields | fields)
        return self


class InvalidRequest(RceError):
    """A frame, command, option or file that does not say what it must. Mend it; sending it again gives the same."""

    code = "invalid_request"


class InvalidName(InvalidRequest):
    """A tag or name that breaks the naming rule: an ASCII letter, then ASCII letters, digits or `_`."""

    code = "invalid_name"


class ConversionError(InvalidRequest):
    """A message that does not fit its ROS type; `field` is the path (`pose.position.x`)."""

    code = "conversion"


class UnknownType(InvalidRequest):
    """A message or service type that neither this platform nor the environment knows."""

    code = "unknown_type"


class NotFound(RceError):
    """What the command names does not exist (or is not yours, which looks the same)."""

    code = "not_found"


class AlreadyExists(RceError):
    """The tag is taken. Use another or remove the present holder first."""

    code = "already_exists"


class NotConnectable(RceError):
    """The two interfaces are not a pair: their kinds are not opposites, or their types differ."""

    code = "not_connectable"


class NotConnected(RceError):
    """The interface has no peer, so the message went nowhere. Wait for its status to become true."""

    code = "not_connected"


class Unauthorized(RceError):
    """Credentials are missing, wrong, expired or revoked."""

    code = "unauthorized"


class TooManyAttempts(RceError):
    """Too many wrong passwords; `retry_after` in `fields` are the seconds to wait. An API key is taken all the same."""

    code = "too_many_attempts"


class Forbidden(RceError):
    """The credentials are good, but their role does not allow this."""

    code = "forbidden"


class NoCapacity(RceError):
    """No machine has room. Remove an environment, ask for a smaller one, or add a machine."""

    code = "no_capacity"


class LimitExceeded(RceError):
    """More than this user, robot or message may have; `fields` has the limit and what was asked."""

    code = "limit_exceeded"


class StartFailed(RceError):
    """An environment or node did not start; the message has the reason and the last lines of its output."""

    code = "start_failed"


class Died(RceError):
    """An environment or node that ran is gone; the message has its exit status."""

    code = "died"


class Unavailable(RceError):
    """The other side cannot be reached at present. Try again: what was acknowledged is kept."""

    code = "unavailable"


class Lost(Unavailable):
    """The connection broke before the answer came: it is not known whether the call was carried out."""

    code = "lost"


class TimedOut(RceError):
    """No answer in time."""

    code = "timed_out"


class InternalError(RceError):
    """A defect of RCE itself. The server's log has the traceback."""

    code = "internal"


def reason(error: OSError) -> str:
    """What the operating system refused, as people say it: `PATH: no such file or directory`."""
    text = os.strerror(error.errno) if error.errno else error.strerror or str(error)
    text = text[:1].lower() + text[1:]
    return f"{os.fsdecode(error.filename)}: {text}" if isinstance(error.filename, str | bytes | os.PathLike) else text


def no_port(host: str, port: int | str, error: OSError) -> Unavailable:
    """Why nobody can be served there."""
    where = f"port {port} of {host or 'all addresses'}"
    if error.errno == errno.EADDRINUSE:
        return Unavailable(f"{where} is in use: choose another port, or end what listens there")
    return Unavailable(f"{where} cannot be had: {reason(error)}")
