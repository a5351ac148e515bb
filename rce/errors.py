"""Errors of RCE, for people and programs.

Each error has a `code` for programs, a message that says what is wrong, where, and what to do, and `fields` with
details. Errors cross process boundaries as `ErrorInfo` and are raised as the same class on the other side. A code that
this version does not know is raised as a plain `RceError`, which keeps the code.
"""

from __future__ import annotations

import errno
import os
from typing import ClassVar

import msgspec

MAX_MESSAGE_LENGTH = 8000  # characters of the message of another process's error
MAX_CODE_LENGTH = 200  # of its other texts
MALFORMED = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
"""Exceptions of msgspec for malformed JSON or msgpack, such as text that is not UTF-8 or lists nested too deeply."""

class_of_code: dict[str, type[RceError]] = {}


class ErrorInfo(msgspec.Struct, frozen=True, omit_defaults=True):
    """An error on the wire.

    Attributes:
        code: Identifies the class of the error.
        message: What is wrong, where, and what to do.
        item: The item of a CN or CX frame that failed, as `addNodes[2]`.
        field: The path of the wrong field, as `pose.position.x`.
        fields: Details.
    """

    code: str
    message: str
    item: str = ""
    field: str = ""
    fields: dict[str, str | int | float | bool | list[str]] = {}


class RceError(Exception):
    """Base class of all errors that RCE raises on purpose."""

    code: ClassVar[str] = "error"

    def __init__(
        self, message: str, *, item: str = "", field: str = "", **fields: str | int | float | bool | list[str]
    ) -> None:
        super().__init__(message)
        self.info = ErrorInfo(self.code, message, item, field, fields)

    def __init_subclass__(cls) -> None:
        class_of_code.setdefault(cls.code, cls)  # a subclass without a code of its own crosses as its base

    def __str__(self) -> str:
        return self.info.message

    @property
    def item(self) -> str:
        """The item of a CN or CX frame that failed, as `addNodes[2]`, or an empty string."""
        return self.info.item

    @property
    def field(self) -> str:
        """The path of the wrong field, as `pose.position.x`, or an empty string."""
        return self.info.field

    @staticmethod
    def from_info(info: ErrorInfo) -> RceError:
        """Make the error that another process or a server sent."""
        error = class_of_code.get(info.code, RceError)(info.message)
        error.info = info
        return error

    def with_item(self, item: str) -> RceError:
        """Set the item of the frame that failed, as `addNodes[2]`; return this error."""
        self.info = msgspec.structs.replace(self.info, item=item)
        return self

    def with_fields(self, **fields: str | int | float | bool | list[str]) -> RceError:
        """Add details; return this error."""
        self.info = msgspec.structs.replace(self.info, fields=self.info.fields | fields)
        return self


class_of_code[RceError.code] = RceError


class InvalidRequest(RceError):
    """A frame, command, option or file is malformed. Correct it; a retry fails in the same way."""

    code = "invalid_request"


class InvalidName(InvalidRequest):
    """A tag or name breaks the naming rule: an ASCII letter, then ASCII letters, digits or `_`."""

    code = "invalid_name"


class ConversionError(InvalidRequest):
    """A message does not match its ROS type; `field` is the path of the wrong field (`pose.position.x`)."""

    code = "conversion"


class UnknownType(InvalidRequest):
    """Neither the platform nor the environment has this message or service type."""

    code = "unknown_type"


class NotFound(RceError):
    """The named object does not exist, or belongs to another user; the error does not tell these apart."""

    code = "not_found"


class AlreadyExists(RceError):
    """The tag is in use. Choose another, or remove the object that has it."""

    code = "already_exists"


class NotConnectable(RceError):
    """The two interfaces do not match: their kinds are not opposite, or their types differ."""

    code = "not_connectable"


class NotConnected(RceError):
    """The interface is not connected, so the message was dropped. Wait until its status is true."""

    code = "not_connected"


class Unauthorized(RceError):
    """The credentials are missing, wrong, expired or revoked."""

    code = "unauthorized"


class TooManyAttempts(RceError):
    """Too many wrong passwords: wait `retry_after` seconds (in `fields`). API keys are accepted in the meantime."""

    code = "too_many_attempts"


class Forbidden(RceError):
    """The credentials are valid, but their role does not permit the operation."""

    code = "forbidden"


class NoCapacity(RceError):
    """No machine has room for the environment. Remove an environment, request a smaller one, or add a machine."""

    code = "no_capacity"


class LimitExceeded(RceError):
    """A limit of the user, robot or message is exceeded; `fields` has the limit and the requested amount."""

    code = "limit_exceeded"


class StartFailed(RceError):
    """An environment or node failed to start; the message has the reason and the last lines of its output."""

    code = "start_failed"


class Died(RceError):
    """A running environment or node ended unexpectedly; the message has its exit status."""

    code = "died"


class Unavailable(RceError):
    """The other side cannot be reached at present. Retry later; everything that it acknowledged is kept."""

    code = "unavailable"


class DiskFull(Unavailable):
    """Something cannot be stored. Make room on the disk and retry."""

    @classmethod
    def at(cls, where: str) -> DiskFull:
        """Return the error with what the operating system or the database said."""
        return cls(f"disk full ({where}): an administrator must make room; then retry")


class Lost(Unavailable):
    """The connection broke before the answer came: the call may or may not have been executed."""

    code = "lost"


class TimedOut(RceError):
    """No answer came before the timeout."""

    code = "timed_out"


class InternalError(RceError):
    """A bug in RCE. The server's log has the traceback."""

    code = "internal"


def clipped(info: ErrorInfo) -> ErrorInfo:
    """Return an error of another process with texts of bounded length, since it is stored and sent to others."""
    fields = info.fields if len(msgspec.msgpack.encode(info.fields)) <= MAX_MESSAGE_LENGTH else {}
    return ErrorInfo(
        info.code[:MAX_CODE_LENGTH],
        info.message[:MAX_MESSAGE_LENGTH],
        info.item[:MAX_CODE_LENGTH],
        info.field[:MAX_CODE_LENGTH],
        fields,
    )


def describe_os_error(error: OSError) -> str:
    """Describe an error of the operating system, as in `PATH: no such file or directory`."""
    text = os.strerror(error.errno) if error.errno else error.strerror or str(error)
    text = text[:1].lower() + text[1:]
    return f"{os.fsdecode(error.filename)}: {text}" if isinstance(error.filename, str | bytes | os.PathLike) else text


def disk_full(error: OSError) -> DiskFull | None:
    """Return the error for users if an error of the operating system means that a disk or a quota is full."""
    return DiskFull.at(describe_os_error(error)) if error.errno in (errno.ENOSPC, errno.EDQUOT) else None


def port_unavailable(host: str, port: int | str, error: OSError) -> Unavailable:
    """Return the error for a port that cannot be listened on."""
    where = f"port {port} of {host or 'all addresses'}"
    if error.errno == errno.EADDRINUSE:
        return Unavailable(f"{where} is in use: choose another port, or stop the program that listens on it")
    return Unavailable(f"cannot listen on {where}: {describe_os_error(error)}")
