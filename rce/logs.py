"""Logging of a process: everything goes through `twisted.logger` to one stream, a line an event.

On a terminal a line is for people; elsewhere it is a JSON object with `time`, `level`, `from`, `message`, the event's
own fields and, with a failure, its `traceback`. What libraries send to Python's `logging` comes out the same way.

What is logged on behalf of a robot's command or of a request over HTTP has its id, as `request`, in every process that
has a part in it: the id goes along with control calls (`rce.control`).
"""

from __future__ import annotations

import logging
import re
import secrets
import sys
import time
from collections.abc import Callable
from contextvars import ContextVar
from datetime import datetime
from typing import IO, Any

import msgspec
from twisted.logger import (
    FileLogObserver,
    FilteringLogObserver,
    LogEvent,
    Logger,
    LogLevel,
    LogLevelFilterPredicate,
    formatEvent,
    globalLogBeginner,
    globalLogPublisher,
)

request: ContextVar[str] = ContextVar("request", default="")
"""The id of what is being done here: that of a connection, `a1b2c3d4`, and of its commands, `a1b2c3d4.1`, `.2`, …"""
_ID = re.compile(r"[\w.:-]{1,80}", re.ASCII)
_OWN = frozenset({"format", "time", "isError", "message"})  # keys that Twisted adds beside those that begin with log_


def enter(id: str = "") -> str:
    """Do what follows in this task under this id, if it is one, else under a new one; returns it."""
    good = id if _ID.fullmatch(id) else secrets.token_hex(4)
    request.set(good)
    return good


def begin(stream: IO[str] = sys.stderr) -> None:
    """Log to `stream` from now on; once a process."""
    lines = FileLogObserver(stream, _for_people if stream.isatty() else _for_programs)
    globalLogBeginner.beginLoggingTo([_from_info(lines)], redirectStandardIO=False)
    logging.basicConfig(level=logging.INFO, handlers=[_FromLogging()], force=True)


def also(write: Callable[[str], None]) -> None:
    """Let each line, as for people, go there too."""

    def observe(event: LogEvent) -> None:
        write(_for_people(event))

    globalLogPublisher.addObserver(_from_info(observe))


def _from_info(observer: Any) -> Any:  # mypy does not see that classes provide zope interfaces
    level = LogLevelFilterPredicate(LogLevel.info)
    # Ports that open and close, a line for each HTTP request. Autobahn warns of bad requests with their credentials.
    for chatty, least in (
        ("log_legacy", LogLevel.warn),
        ("twisted.python.log", LogLevel.warn),
        ("autobahn", LogLevel.error),
    ):
        level.setLogLevelForNamespace(chatty, least)
    return FilteringLogObserver(observer, [level])  # type: ignore[list-item]


class Sparing:
    """Warns at most once in `pause` seconds, and of how many more there were: of what strangers can do at will."""

    def __init__(self, log: Logger, pause: float = 10.0, now: Callable[[], float] = time.monotonic) -> None:
        self._log = log
        self._pause = pause
        self._now = now
        self._next = 0.0
        self._left_out = 0

    def warn(self, format: str, **fields: object) -> None:
        if self._now() < self._next:
            self._left_out += 1
            return
        more = " (and {left_out} like it before)" if self._left_out else ""
        self._log.warn(format + more, left_out=self._left_out, **fields)
        self._next, self._left_out = self._now() + self._pause, 0


class _FromLogging(logging.Handler):
    """Hands the records of Python's `logging` to Twisted's."""

    def emit(self, record: logging.LogRecord) -> None:
        level = LogLevel.lookupByName(record.levelname.lower().replace("warning", "warn"))
        text = record.getMessage()
        if record.exc_info:
            text += "\n" + logging.Formatter().formatException(record.exc_info)
        Logger(namespace=record.name).emit(level, "{text}", text=text)


def _for_people(event: LogEvent) -> str:
    clock = datetime.fromtimestamp(event["log_time"]).strftime("%H:%M:%S.%f")[:-3]
    line = f"{clock} {event['log_level'].name:5} {event.get('log_namespace', '-')}: {formatEvent(event)}"
    line += f" [{id}]" if (id := request.get()) else ""
    return f"{line}\n{_traceback(event)}\n" if "log_failure" in event else line + "\n"


def _for_programs(event: LogEvent) -> str:
    line = {
        "time": datetime.fromtimestamp(event["log_time"]).astimezone().isoformat(timespec="milliseconds"),
        "level": event["log_level"].name,
        "from": event.get("log_namespace", ""),
        "message": formatEvent(event),
    }
    if id := request.get():
        line["request"] = id
    line |= {key: value for key, value in event.items() if not key.startswith("log_") and key not in _OWN}
    if "log_failure" in event:
        line["traceback"] = _traceback(event)
    return msgspec.json.encode(line, enc_hook=str).decode() + "\n"


def _traceback(event: LogEvent) -> str:
    text: str = event["log_failure"].getTraceback()
    return text.rstrip()
