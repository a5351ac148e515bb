"""Control calls over a real connection."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

import pytest
from twisted.internet.base import ReactorBase

import rce
from rce import control, metrics
from rce.calls.call import Nothing, Ping
from rce.calls.endpoints import NodeDied
from rce.calls.joining import Hello, Welcome
from rce.calls.watching import Log, ReadLog, ReadMetrics
from rce.control import Control, Handlers, MasterLink, connect, listen
from rce.errors import InternalError, InvalidRequest, Unavailable

HELLO = Hello("container", "m1", "token", "1")
LOCAL = "tcp:0:interface=127.0.0.1"


class Doorman:
    """Lets everybody in; the other side's calls are answered by `handlers`."""

    def __init__(self) -> None:
        self.handlers = Handlers()
        self.joined: asyncio.Queue[Control] = asyncio.Queue()

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        return Welcome("credential"), self.handlers, self.joined.put_nowait


async def test_calls_go_both_ways_and_may_be_large(reactor: ReactorBase) -> None:
    doorman, handlers = Doorman(), Handlers()
    heard: list[NodeDied] = []

    async def read(call: ReadLog) -> Log:
        return Log(["x" * call.lines])

    async def died(call: NodeDied) -> Nothing:
        heard.append(call)
        return Nothing()

    handlers.on(ReadLog, read)
    doorman.handlers.on(NodeDied, died)
    port = await listen(reactor, LOCAL, doorman)
    there, welcome = await connect(reactor, f"tcp:127.0.0.1:{port.getHost().port}", HELLO, handlers)  # type: ignore[misc]
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    assert welcome == Welcome("credential")
    assert len((await here.call(ReadLog("n", 3_000_000))).lines[0]) == 3_000_000
    await there.call(NodeDied("n", 1, ["y" * 2_000_000]))
    assert len(heard[0].lines[0]) == 2_000_000
    there.close()
    await asyncio.wait_for(here.lost, 10)
    with pytest.raises(Unavailable):
        await here.call(ReadLog("n"))
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def test_a_lost_connection_ends_the_calls_under_way(reactor: ReactorBase) -> None:
    doorman, handlers = Doorman(), Handlers()

    async def hang(call: ReadLog) -> Log:
        there.close()
        await asyncio.Event().wait()
        return Log([])

    handlers.on(ReadLog, hang)
    port = await listen(reactor, LOCAL, doorman)
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{port.getHost().port}", HELLO, handlers)  # type: ignore[misc]
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    with pytest.raises(Unavailable, match="ReadLog"):
        await asyncio.wait_for(here.call(ReadLog("n")), 10)
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def test_a_defect_is_logged_there_and_reported_here(reactor: ReactorBase, failures: list[object]) -> None:
    doorman, handlers = Doorman(), Handlers()

    async def broken(call: ReadLog) -> Log:
        raise ZeroDivisionError

    handlers.on(ReadLog, broken)
    port = await listen(reactor, LOCAL, doorman)
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{port.getHost().port}", HELLO, handlers)  # type: ignore[misc]
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    with pytest.raises(InternalError, match="ReadLog"):
        await here.call(ReadLog("n"))
    assert len(failures) == 1
    failures.clear()
    there.close()
    await here.lost
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def test_an_answer_of_another_type_is_an_error_of_the_call(reactor: ReactorBase) -> None:
    doorman, handlers = Doorman(), Handlers()

    async def wrong(call: ReadLog) -> Ping:
        return Ping()

    handlers.on(ReadLog, wrong)  # type: ignore[arg-type]
    port = await listen(reactor, LOCAL, doorman)
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{port.getHost().port}", HELLO, handlers)  # type: ignore[misc]
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    with pytest.raises(InvalidRequest, match="ReadLog with something else"):
        await here.call(ReadLog("n"))
    there.close()
    await here.lost
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def test_a_process_tells_its_metrics(reactor: ReactorBase) -> None:
    doorman, handlers = Doorman(), Handlers()
    handlers.tell_metrics("robot", lambda: [metrics.gauge("rce_links", "Links", [], {(): 3})])
    port = await listen(reactor, LOCAL, doorman)
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{port.getHost().port}", HELLO, handlers)  # type: ignore[misc]
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    with pytest.raises(InvalidRequest):
        await here.call(ReadLog("n"))
    found = {each.name: each for each in (await here.call(ReadMetrics())).families}
    assert found["rce_links"].samples == [metrics.Sample([], 3)]
    assert found["rce_info"].samples == [metrics.Sample(["robot", rce.__version__], 1)]
    assert any(each.labels == ["process", "invalid_request"] for each in found["rce_errors"].samples)
    assert found["process_open_fds"].samples[0].value > 3
    there.close()
    await here.lost
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def test_a_silent_master_is_given_up(reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "JOIN_TIMEOUT", 0.02)
    closed = asyncio.Event()

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionResetError):
            await reader.read()
        writer.close()
        closed.set()

    async with await asyncio.start_server(silent, "127.0.0.1", 0) as server:
        address = server.sockets[0].getsockname()
        with pytest.raises(Unavailable, match=r"no answer within 0\.02 s"):
            await connect(reactor, f"tcp:127.0.0.1:{address[1]}", HELLO, Handlers())
        await asyncio.wait_for(closed.wait(), 10)


async def test_a_master_that_ends_while_it_is_joined_is_noticed_at_once(reactor: ReactorBase) -> None:
    """Its kernel may still have accepted the connection."""

    async def end(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    async with await asyncio.start_server(end, "127.0.0.1", 0) as server:
        description = f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}"
        with pytest.raises(Unavailable, match="lost"):
            await asyncio.wait_for(connect(reactor, description, HELLO, Handlers()), control.JOIN_TIMEOUT / 2)


async def test_a_link_that_is_stopped_closes_its_connection(reactor: ReactorBase) -> None:
    doorman = Doorman()
    port = await listen(reactor, LOCAL, doorman)
    description = f"tcp:127.0.0.1:{port.getHost().port}"  # type: ignore[misc]
    link = MasterLink(reactor, description, lambda: HELLO, Handlers(), lambda welcome: None)
    task = asyncio.create_task(link.run())
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    task.cancel()
    await asyncio.wait_for(here.lost, 10)
    await asyncio.wait({task})
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]
