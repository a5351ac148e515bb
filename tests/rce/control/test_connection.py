"""Control calls over a real connection."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import pytest
from msgspec import Raw
from twisted.internet.base import ReactorBase
from twisted.logger import Logger
from twisted.spread import pb

import rce
from rce.control.calls.call import Nothing
from rce.control.calls.endpoints import StopNode
from rce.control.calls.watching import Log, ReadLog, ReadMetrics
from rce.control.connection import Handlers
from rce.control.pages import Question, encode, encode_pages
from rce.errors import ErrorInfo, InternalError, InvalidRequest, NotFound, Unavailable
from rce.process import logs, metrics
from tests.support.control import TIMEOUT, closed, listening


def answering(read: Callable[[ReadLog], Awaitable[Log]]) -> Handlers:
    handlers = Handlers()
    handlers.on(ReadLog, read)
    return handlers


async def test_large_calls_and_results_in_both_directions(reactor: ReactorBase) -> None:
    received: list[StopNode] = []

    async def read(call: ReadLog) -> Log:
        return Log(["x" * call.lines])

    handlers = Handlers()
    handlers.do(StopNode, received.append)
    async with listening(reactor, handlers) as listener:
        client, server = await listener.pair(answering(read))
        assert len((await server.call(ReadLog("n", 3_000_000))).lines[0]) == 3_000_000
        await client.call(StopNode("y" * 2_000_000))
        assert len(received[0].node) == 2_000_000
        await closed(client, server)
        with pytest.raises(Unavailable):
            await server.call(ReadLog("n"))


async def test_pending_call_fails_when_the_connection_is_lost(reactor: ReactorBase) -> None:
    async def hang(call: ReadLog) -> Log:
        client.close()
        await asyncio.Event().wait()
        return Log([])

    async with listening(reactor) as listener:
        client, server = await listener.pair(answering(hang))
        with pytest.raises(Unavailable, match="ReadLog"):
            await asyncio.wait_for(server.call(ReadLog("n")), TIMEOUT)


async def test_unhandled_exception_is_logged_and_raised_as_internal_error(
    reactor: ReactorBase, failures: list[object]
) -> None:
    async def broken(call: ReadLog) -> Log:
        raise ZeroDivisionError

    async with listening(reactor) as listener:
        client, server = await listener.pair(answering(broken))
        with pytest.raises(InternalError, match="ReadLog"):
            await server.call(ReadLog("n"))
        assert len(failures) == 1
        failures.clear()
        await closed(client, server)


async def test_full_disk_is_told(reactor: ReactorBase) -> None:
    async def broken(call: ReadLog) -> Log:
        raise OSError(errno.ENOSPC, "no space", "output.log")

    async with listening(reactor) as listener:
        client, server = await listener.pair(answering(broken))
        with pytest.raises(Unavailable, match=r"disk full \(output.log: no space"):
            await server.call(ReadLog("n"))
        await closed(client, server)


async def test_result_of_a_wrong_type_is_an_error(reactor: ReactorBase) -> None:
    async def wrong(call: ReadLog) -> Nothing:
        return Nothing()

    async with listening(reactor) as listener:
        client, server = await listener.pair(answering(wrong))  # type: ignore[arg-type]
        with pytest.raises(InvalidRequest, match="ReadLog with something else"):
            await server.call(ReadLog("n"))
        await closed(client, server)


@pytest.mark.parametrize(
    "page", [b"\x81\xa4node\xa1\xff", b"\xff", b"\x91" * 5000 + b"\x01"], ids=["no UTF-8", "no map", "deep"]
)
async def test_malformed_call_is_refused_without_a_traceback(page: bytes) -> None:
    answer = await answering(never).answer(Question("ReadLog", "", 0, Raw(page)))
    assert not answer.good
    assert msgspec.msgpack.decode(answer.value, type=ErrorInfo).code == InvalidRequest.code


@pytest.mark.parametrize("end", [0, 1], ids=["connecting", "accepting"])
@pytest.mark.parametrize("pages", [(), (b"\xff",), (7,), (b"\x94", [b"x"])], ids=str)
async def test_call_that_the_peer_does_not_understand_fails(reactor: ReactorBase, end: int, pages: Any) -> None:
    async with listening(reactor) as listener:
        client, server = await listener.pair(Handlers())
        call = (client, server)[end]._receiver.callRemote("call", *pages).asFuture(asyncio.get_running_loop())
        with pytest.raises(pb.Error, match="not understood"):
            await asyncio.wait_for(call, TIMEOUT)
        await closed(client, server)


async def test_call_with_keywords_is_not_understood(reactor: ReactorBase) -> None:
    pages = encode_pages(Question("ReadLog", "", 0, encode(ReadLog("n"))))
    async with listening(reactor) as listener:
        client, server = await listener.pair(answering(never))
        call = server._receiver.callRemote("call", *pages, more=b"x").asFuture(asyncio.get_running_loop())
        with pytest.raises(pb.Error, match="not understood"):
            await asyncio.wait_for(call, TIMEOUT)
        await closed(client, server)


async def never(call: ReadLog) -> Log:
    raise AssertionError("it is called")


async def test_metrics_of_a_process(reactor: ReactorBase) -> None:
    handlers = Handlers()
    handlers.serve_metrics("robot", lambda: [metrics.gauge_family("rce_links", "Links", [], {(): 3})])
    async with listening(reactor) as listener:
        client, server = await listener.pair(handlers)
        with pytest.raises(InvalidRequest):
            await server.call(ReadLog("n"))
        found = {each.name: each for each in (await server.call(ReadMetrics())).families}
        assert found["rce_links"].samples == [metrics.Sample([], 3)]
        assert found["rce_info"].samples == [metrics.Sample(["robot", rce.__version__], 1)]
        assert any(each.labels == ["process", "invalid_request"] for each in found["rce_errors"].samples)
        assert found["process_open_fds"].samples[0].value > 3
        await closed(client, server)


async def test_calls_carry_the_request_id(reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch) -> None:
    ids: list[str] = []
    events: list[tuple[str, str]] = []

    async def stop(call: StopNode) -> Nothing:
        ids.append(logs.request_id.get())
        if call.node == "missing":
            raise NotFound("no such node")
        return Nothing()

    async def read(call: ReadLog) -> Log:
        ids.append(logs.request_id.get())
        return Log([])

    def observe(event: dict[str, object]) -> None:
        events.append((logs.request_id.get(), str(event["log_format"]).partition(":")[0]))

    handlers = answering(read)
    handlers.on(StopNode, stop)
    monkeypatch.setattr("rce.control.connection.log", Logger(observer=observe))  # type: ignore[arg-type]
    async with listening(reactor) as listener:
        client, server = await listener.pair(handlers)

        async def command() -> None:
            logs.set_request_id("a1b2.3")
            await server.call(StopNode("n"))
            await server.call(ReadLog("n"))
            with pytest.raises(NotFound):
                await server.call(StopNode("missing"))

        await asyncio.create_task(command())
        await server.call(ReadLog("n"))
        assert ids == ["a1b2.3"] * 3 + [""]
        assert events == [("a1b2.3", "{call} is done in {seconds"), ("a1b2.3", "{call} failed")]
        await closed(client, server)
