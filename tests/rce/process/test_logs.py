"""Log lines: for programs, and with the id of what they are about, across processes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import datetime

import msgspec
import pytest
from twisted.logger import Logger, LogLevel, formatEvent

from rce.process import logs


class Observer:
    """Log observer that keeps all events."""

    def __init__(self) -> None:
        self.events: list[dict[str, object]] = []

    def __call__(self, event: dict[str, object]) -> None:
        self.events.append(event)


def line_of(event: Callable[[Logger], None]) -> dict[str, object]:
    seen = Observer()
    event(Logger(namespace="test", observer=seen))  # type: ignore[arg-type]  # a function is an observer
    found: dict[str, object] = msgspec.json.decode(logs._json_line(seen.events[0]))
    return found


def test_json_line_has_the_request_id_and_the_fields() -> None:
    assert "request" not in line_of(lambda log: log.info("plain"))
    token = logs.request_id.set("a1b2.3")
    try:
        line = line_of(lambda log: log.info("{name} is started", name="ann/map"))
    finally:
        logs.request_id.reset(token)
    assert (line["message"], line["name"], line["request"], line["level"]) == (
        "ann/map is started",
        "ann/map",
        "a1b2.3",
        "info",
    )


@pytest.mark.parametrize("time", [0.0, 1_700_000_000.0, 1_700_000_000.25, 1_700_000_001.75])
def test_lines_have_the_local_time_in_milliseconds(time: float) -> None:
    event = {"log_time": time, "log_level": LogLevel.info, "log_format": "hello", "log_namespace": "x"}
    text = msgspec.json.decode(logs._json_line(event))["time"]
    local = datetime.fromtimestamp(time).astimezone()
    assert text == local.isoformat(timespec="milliseconds")
    assert logs._text_line(event).startswith(f"{text[11:23]} info  x: hello")


@pytest.mark.parametrize("quiet", [False, True])
def test_events_below_the_level_of_their_namespace_are_dropped(quiet: bool) -> None:
    seen = Observer()
    observe = logs._filtered(seen, quiet)
    for namespace in ("rce", "autobahn", "autobahn.websocket", "alembic"):
        for level in LogLevel.iterconstants():
            observe({"log_level": level, "log_namespace": namespace})
    observe({"log_namespace": "rce"})
    found = [f"{event['log_namespace']} {getattr(event['log_level'], 'name', '')}" for event in seen.events]
    rest = ["warn", "error", "critical"]
    assert found == [
        *(f"rce {name}" for name in (["info"] * (not quiet) + rest)),
        *(f"{namespace} {name}" for namespace in ("autobahn", "autobahn.websocket") for name in rest[1:]),
        *(f"alembic {name}" for name in rest),
    ]


def test_text_line_ends_with_the_request_id() -> None:
    event = {"log_time": 0.0, "log_level": LogLevel.info, "log_format": "hello", "log_namespace": "x"}
    token = logs.request_id.set("a1b2.3")
    try:
        assert logs._text_line(event).endswith("x: hello [a1b2.3]\n")
    finally:
        logs.request_id.reset(token)


@pytest.mark.parametrize("malformed", ["", "with blank", "x" * 81, "new\nline", "ä"])
async def test_malformed_request_id_is_replaced(malformed: str) -> None:
    async def inside() -> str:
        assert logs.set_request_id("good:1.2-3_4") == "good:1.2-3_4"
        return logs.set_request_id(malformed)

    made = await asyncio.create_task(inside())  # in a task of its own, since the id stays set for the task
    assert made != malformed
    assert len(made) == 8


@pytest.mark.parametrize("level", [LogLevel.info, LogLevel.warn])
def test_autobahn_warning_about_a_bad_request_is_not_logged(level: LogLevel) -> None:
    """The warning has the request line, which may contain the key of a robot."""
    seen = Observer()
    log = Logger(namespace="autobahn.asyncio.websocket", observer=logs._filtered(seen))
    log.emit(level, "dropping connection: Bad HTTP request status line")
    assert seen.events == []
    log.error("defect")
    assert len(seen.events) == 1


@pytest.mark.parametrize(
    ("namespace", "level"),
    [("aiohttp.websocket", LogLevel.warn), ("alembic.runtime.plugins.x", LogLevel.info), ("twisted.x", LogLevel.debug)],
)
def test_noise_of_libraries_is_not_logged(namespace: str, level: LogLevel) -> None:
    seen = Observer()
    log = Logger(namespace=namespace, observer=logs._filtered(seen))
    log.emit(level, "noise")
    assert seen.events == []


@pytest.mark.parametrize(("quiet", "seen"), [(False, ["told", "warned"]), (True, ["warned"])])
def test_quiet_process_logs_warnings_and_errors_only(quiet: bool, seen: list[str]) -> None:
    observer = Observer()
    log = Logger(namespace="any", observer=logs._filtered(observer, quiet))
    log.info("told")
    log.warn("warned")
    assert [event["log_format"] for event in observer.events] == seen


def test_rate_limited_logger_suppresses_and_counts_warnings() -> None:
    seen, now = Observer(), 100.0
    limited = logs.RateLimitedLogger(Logger(namespace="test", observer=seen), 10.0, lambda: now)  # type: ignore[arg-type]
    for _ in range(3):
        limited.warn("no key from {address}", address="a")
    now += 10
    limited.warn("no key from {address}", address="b")
    lines = [formatEvent(event) for event in seen.events]
    assert lines == ["no key from a", "no key from b (2 similar warnings suppressed)"]


def test_text_of_a_namespace_has_its_events_and_all_warnings() -> None:
    lines: list[str] = []
    logs.add_text_observer(lines.append, "tests.environment.")
    for namespace in ("tests.environment.nodes", "tests.control"):
        log = Logger(namespace)
        log.info("an info")
        log.warn("a warn")
    assert [line.split()[-1] for line in lines if "tests." in line] == ["info", "warn", "warn"]
