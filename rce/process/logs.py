"""Logging of a process: all events go through `twisted.logger` to one stream, one line per event.

On a terminal the lines are plain text. Otherwise each is a JSON object with `time`, `level`, `from`, `message`, the
fields of the event and, for a failure, its `traceback`. Records of Python's `logging`, which libraries use, are logged
in the same way.

Events that a robot's command or an HTTP request causes have its id as `request`, in every process that takes part:
control calls carry the id along (`rce.control.connection`).
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
from functools import cache, lru_cache
from typing import IO, Any

import msgspec
from twisted.logger import (
    FileLogObserver,
    LogEvent,
    Logger,
    LogLevel,
    LogLevelFilterPredicate,
    formatEvent,
    globalLogBeginner,
    globalLogPublisher,
)

request_id: ContextVar[str] = ContextVar("request_id", default="")
"""Id of the request that the current task serves: `a1b2c3d4` for a connection, `a1b2c3d4.1` … for its commands."""
_ID = re.compile(r"[\w.:-]{1,80}", re.ASCII)
_RANKS = {level: rank for rank, level in enumerate(LogLevel.iterconstants())}  # from debug to critical
_TWISTED_KEYS = frozenset({"format", "time", "isError", "message"})  # keys of Twisted without the prefix log_


def set_request_id(id: str = "") -> str:
    """Set the request id of the current task, a new one if `id` is empty or malformed; return it."""
    valid = id if _ID.fullmatch(id) else secrets.token_hex(4)
    request_id.set(valid)
    return valid


def start(stream: IO[str] = sys.stderr, *, quiet: bool = False) -> None:
    """Start to log to `stream`, if `quiet` only warnings and errors. Call it once in a process."""
    lines = FileLogObserver(stream, _text_line if stream.isatty() else _json_line)
    globalLogBeginner.beginLoggingTo([_filtered(lines, quiet)], redirectStandardIO=False)
    logging.basicConfig(level=logging.INFO, handlers=[_FromLogging()], force=True)


def add_text_observer(write: Callable[[str], None], of: str = "") -> None:
    """Also write each event as a line of plain text with `write`.

    Args:
        write: Called with each line.
        of: Namespace; of other ones only warnings and errors are written. Empty: everything is.
    """

    def observe(event: LogEvent) -> None:
        if event["log_level"] >= LogLevel.warn or (event.get("log_namespace") or "").startswith(of):
            write(_text_line(event))

    globalLogPublisher.addObserver(_filtered(observe))


def _filtered(observer: Any, quiet: bool = False) -> Any:  # mypy does not see that classes provide zope interfaces
    level = LogLevelFilterPredicate(LogLevel.warn if quiet else LogLevel.info)
    # Twisted logs each opened port and each HTTP request. Autobahn logs malformed requests with their credentials,
    # aiohttp each WebSocket handshake with an unknown subprotocol, Alembic each of its steps.
    for namespace, lowest in (
        ("log_legacy", LogLevel.warn),
        ("twisted.python.log", LogLevel.warn),
        ("autobahn", LogLevel.error),
        ("aiohttp.websocket", LogLevel.error),
        ("alembic", LogLevel.warn),
    ):
        level.setLogLevelForNamespace(namespace, lowest)
    rank_of = cache(lambda namespace: _RANKS[level.logLevelForNamespace(namespace)])  # there are few namespaces

    def observe(event: LogEvent) -> None:
        if _RANKS.get(event.get("log_level"), -1) >= rank_of(event.get("log_namespace") or ""):
            observer(event)

    return observe


class RateLimitedLogger:
    """Logger for warnings that unauthenticated peers can cause: at most one in `interval` seconds.

    Each warning says how many were suppressed since the last one.
    """

    def __init__(self, log: Logger, interval: float = 10.0, now: Callable[[], float] = time.monotonic) -> None:
        self._log = log
        self._interval = interval
        self._now = now
        self._next = 0.0
        self._suppressed = 0

    def warn(self, format: str, **fields: object) -> None:
        """Log a warning, or only count it."""
        if self._now() < self._next:
            self._suppressed += 1
            return
        more = " ({suppressed} similar warnings suppressed)" if self._suppressed else ""
        self._log.warn(format + more, suppressed=self._suppressed, **fields)
        self._next, self._suppressed = self._now() + self._interval, 0


class _FromLogging(logging.Handler):
    """Handler that passes the records of Python's `logging` to Twisted's logger."""

    def emit(self, record: logging.LogRecord) -> None:
        level = LogLevel.lookupByName(record.levelname.lower().replace("warning", "warn"))
        text = record.getMessage()
        if record.exc_info:
            text += "\n" + logging.Formatter().formatException(record.exc_info)
        Logger(namespace=record.name).emit(level, "{text}", text=text)


def _text_line(event: LogEvent) -> str:
    line = (
        f"{_local_time(event)[11:23]} {event['log_level'].name:5} {event.get('log_namespace', '-')}: {_message(event)}"
    )
    line += f" [{id}]" if (id := request_id.get()) else ""
    return f"{line}\n{_traceback(event)}\n" if "log_failure" in event else line + "\n"


def _json_line(event: LogEvent) -> str:
    line = {
        "time": _local_time(event),
        "level": event["log_level"].name,
        "from": event.get("log_namespace", ""),
        "message": _message(event),
    }
    if id := request_id.get():
        line["request"] = id
    line |= {key: value for key, value in event.items() if not key.startswith("log_") and key not in _TWISTED_KEYS}
    if "log_failure" in event:
        line["traceback"] = _traceback(event)
    return msgspec.json.encode(line, enc_hook=str).decode() + "\n"


def _local_time(event: LogEvent) -> str:
    """Return the time of an event with milliseconds and the offset of its time zone."""
    second, rest = divmod(event["log_time"], 1)
    text = _local_second(int(second))
    return f"{text[:19]}.{int(rest * 1000):03}{text[19:]}"


@lru_cache(maxsize=1)
def _local_second(second: int) -> str:
    return datetime.fromtimestamp(second).astimezone().isoformat()


def _message(event: LogEvent) -> str:
    """Return the event's text. Twisted's `formatEvent` takes ten times as long, and is for formats with calls."""
    try:
        text: str = event["log_format"].format_map(event)
    except Exception:  # noqa: BLE001  # the format has calls, or is missing, or `str` of a value fails
        return formatEvent(event)
    return text


def _traceback(event: LogEvent) -> str:
    text: str = event["log_failure"].getTraceback()
    return text.rstrip()
