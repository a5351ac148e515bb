"""Log lines: for programs, and with the id of what they are about, across processes."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable

import msgspec
import pytest
from twisted.internet.base import ReactorBase
from twisted.logger import Logger, LogLevel, formatEvent

from rce import logs
from rce.calls.call import Nothing
from rce.calls.endpoints import StopNode
from rce.calls.joining import Hello, Welcome
from rce.calls.watching import Log, ReadLog
from rce.control import Control, Handlers, connect, listen
from rce.errors import NotFound


class _Event:
    """One line, as it is made."""

    def __init__(self) -> None:
        self.events: list[dict[str, object]] = []

    def __call__(self, event: dict[str, object]) -> None:
        self.events.append(event)


def line_of(event: Callable[[Logger], None]) -> dict[str, object]:
    seen = _Event()
    event(Logger(namespace="test", observer=seen))  # type: ignore[arg-type]  # a function is an observer
    found: dict[str, object] = msgspec.json.decode(logs._for_programs(seen.events[0]))
    return found


def test_a_line_for_programs_has_the_request_and_the_fields() -> None:
    assert "request" not in line_of(lambda log: log.info("plain"))
    token = logs.request.set("a1b2.3")
    try:
        line = line_of(lambda log: log.info("{name} is started", name="ann/map"))
    finally:
        logs.request.reset(token)
    assert (line["message"], line["name"], line["request"], line["level"]) == (
        "ann/map is started",
        "ann/map",
        "a1b2.3",
        "info",
    )


def test_a_line_for_people_ends_with_the_request() -> None:
    event = {"log_time": 0.0, "log_level": LogLevel.info, "log_format": "hello", "log_namespace": "x"}
    token = logs.request.set("a1b2.3")
    try:
        assert logs._for_people(event).endswith("x: hello [a1b2.3]\n")
    finally:
        logs.request.reset(token)


@pytest.mark.parametrize("odd", ["", "with blank", "x" * 81, "new\nline", "ä"])
async def test_an_id_that_is_none_is_replaced(odd: str) -> None:
    async def inside() -> str:
        assert logs.enter("good:1.2-3_4") == "good:1.2-3_4"
        return logs.enter(odd)

    made = await asyncio.create_task(inside())  # of its own: what it enters ends with it
    assert made != odd
    assert len(made) == 8


class _Doorman:
    def __init__(self) -> None:
        self.joined: asyncio.Queue[Control] = asyncio.Queue()

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        return Welcome(""), Handlers(), self.joined.put_nowait


async def test_the_id_goes_along_with_calls(reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch) -> None:
    doorman, handlers, seen = _Doorman(), Handlers(), io.StringIO()
    heard: list[str] = []

    async def stop(call: StopNode) -> Nothing:
        heard.append(logs.request.get())
        if call.node == "missing":
            raise NotFound("no such node")
        return Nothing()

    async def read(call: ReadLog) -> Log:
        heard.append(logs.request.get())
        return Log([])

    handlers.on(StopNode, stop)
    handlers.on(ReadLog, read)
    monkeypatch.setattr("rce.control.log", Logger(observer=lambda event: seen.write(logs._for_programs(event))))  # type: ignore[arg-type]
    port = await listen(reactor, "tcp:0:interface=127.0.0.1", doorman)
    number = port.getHost().port  # type: ignore[misc]
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{number}", Hello("robot", "r", "", "1"), handlers)
    here = await asyncio.wait_for(doorman.joined.get(), 10)

    async def command() -> None:
        logs.enter("a1b2.3")
        await here.call(StopNode("n"))
        await here.call(ReadLog("n"))
        with pytest.raises(NotFound):
            await here.call(StopNode("missing"))

    await asyncio.create_task(command())
    await here.call(ReadLog("n"))
    assert heard == ["a1b2.3"] * 3 + [""]
    lines = [msgspec.json.decode(line) for line in seen.getvalue().splitlines()]
    assert [(line["request"], line["message"].split(" ")[:3]) for line in lines] == [
        ("a1b2.3", ["StopNode", "is", "done"]),
        ("a1b2.3", ["StopNode", "was", "refused:"]),
    ]
    there.close()
    await here.lost
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


@pytest.mark.parametrize("level", [LogLevel.info, LogLevel.warn])
def test_what_autobahn_says_of_a_bad_request_is_left_out(level: LogLevel) -> None:
    """It has the whole line, with the key of a robot whose id has a space, say."""
    seen = _Event()
    log = Logger(namespace="autobahn.asyncio.websocket", observer=logs._from_info(seen))
    log.emit(level, "dropping connection: Bad HTTP request status line")  # type: ignore[arg-type]  # constantly's
    assert seen.events == []
    log.error("defect")
    assert len(seen.events) == 1


def test_what_strangers_can_do_at_will_is_said_now_and_then() -> None:
    seen, now = _Event(), 100.0
    strangers = logs.Sparing(Logger(namespace="test", observer=seen), 10.0, lambda: now)  # type: ignore[arg-type]
    for _ in range(3):
        strangers.warn("no key from {address}", address="a")
    now += 10
    strangers.warn("no key from {address}", address="b")
    said = [formatEvent(event) for event in seen.events]  # type: ignore[arg-type]
    assert said == ["no key from a", "no key from b (and 2 like it before)"]
