"""Data relay: connections that it establishes, requests that it refuses, and its limits."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import pytest

from containers import data_relay as module
from containers.data_relay import GATE, DataRelay
from rce.errors import InvalidRequest
from rce.net.relay_handshake import RelayRequest, refusal_reason
from rce.net.sockets import bind_unix_socket, unix_socket_path
from rce.process.metrics import Counter, Sample

Reader = asyncio.StreamReader
Writer = asyncio.StreamWriter
WAIT = 20.0


class Machine:
    """Relay of a machine with environments that answer every line with their name and the line."""

    def __init__(self, directory: Path) -> None:
        self.relay = DataRelay()
        self.directory = directory
        self._servers: list[asyncio.Server] = []

    async def start(self, *names: str) -> Machine:
        await self.relay.listen("127.0.0.1", 0)
        for name in names:
            await self.run(name)
        return self

    async def run(self, name: str) -> None:
        directory = self.directory / name
        directory.mkdir(parents=True)

        async def answer(reader: Reader, writer: Writer) -> None:
            with suppress(ConnectionError):
                while line := await reader.readline():
                    writer.write(f"{name}: ".encode() + line)
                    await writer.drain()
            writer.close()

        listener = bind_unix_socket(directory / "data.sock")
        self._servers.append(await asyncio.start_unix_server(answer, sock=listener, limit=4_000_000))
        await self.relay.add_environment(name, directory / "data.sock", directory)

    async def stop(self) -> None:
        await self.relay.close()
        for server in self._servers:
            server.close()

    @property
    def address(self) -> str:
        return self.relay.address.removeprefix("relay:")

    async def call(self, request: RelayRequest | bytes) -> tuple[Reader, Writer]:
        """Connect as a caller from another machine does."""
        host, _, port = self.address.rpartition(":")
        reader, writer = await asyncio.open_connection(host, int(port), limit=4_000_000)
        writer.write(request if isinstance(request, bytes) else request.line())
        return reader, writer

    async def call_from(self, name: str, request: RelayRequest) -> tuple[Reader, Writer]:
        """Connect as an environment of this machine does."""
        with unix_socket_path(self.directory / name / GATE) as path:
            reader, writer = await asyncio.open_unix_connection(path, limit=4_000_000)
        writer.write(request.line())
        return reader, writer


@pytest.fixture
async def west(tmp_path: Path) -> AsyncIterator[Machine]:
    machine = await Machine(tmp_path / "west").start("ann/brain", "bob/brain")
    yield machine
    await machine.stop()


@pytest.fixture
async def east(tmp_path: Path, west: Machine) -> AsyncIterator[Machine]:
    machine = await Machine(tmp_path / "east").start("ann/eye", "bob/eye")
    for one in (machine, west):
        one.relay.set_relays([west.address, machine.address])
    yield machine
    await machine.stop()


async def received(reader: Reader) -> bytes:
    return await asyncio.wait_for(reader.readline(), WAIT)


async def reason(reader: Reader) -> str:
    """Return the reason of the relay's refusal; empty if it closes the connection without one."""
    try:
        return refusal_reason(await asyncio.wait_for(reader.read(), WAIT))
    except ConnectionError:
        return ""


async def assert_connected_to(name: str, reader: Reader, writer: Writer) -> None:
    writer.write(b"again\n")
    assert await received(reader) == f"{name}: again\n".encode()
    writer.close()


async def test_caller_from_another_machine_reaches_environment(west: Machine) -> None:
    for request in (RelayRequest("ann/brain"), RelayRequest("ann/brain", user="ann")):
        reader, writer = await west.call(request.line() + b"early\n")
        assert await received(reader) == b"ann/brain: early\n"
        large = b"x" * 3_000_000 + b"\n"
        writer.write(large)
        assert await received(reader) == b"ann/brain: " + large
        writer.close()


async def test_relayed_bytes_and_refusals_are_counted(west: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_passed", Counter("rce_relay_bytes", ""))
    monkeypatch.setattr(module, "_refusals", Counter("rce_relay_refusals", "", "reason"))
    reader, writer = await west.call(RelayRequest("ann/brain"))
    writer.write(b"hello\n")
    assert await reader.readline() == b"ann/brain: hello\n"
    (family,) = west.relay.families()
    assert {tuple(each.labels): each.value for each in family.samples} == {("asking",): 0, ("taken",): 1}
    assert module._passed.family().samples == [Sample([], len("hello\n") + len("ann/brain: hello\n"))]
    refused_reader, _ = await west.call(RelayRequest("ann/nobody"))
    await refused_reader.read()
    assert module._refusals.family().samples == [Sample(["not here"], 1)]
    writer.close()


async def test_request_may_arrive_in_parts(west: Machine) -> None:
    reader, writer = await west.call(b"")
    for byte in RelayRequest("ann/brain").line():
        writer.write(bytes([byte]))
        await asyncio.sleep(0)
    await assert_connected_to("ann/brain", reader, writer)


async def test_environment_reaches_environment_of_same_user_on_another_machine(west: Machine, east: Machine) -> None:
    await assert_connected_to("ann/brain", *await east.call_from("ann/eye", RelayRequest("ann/brain", west.address)))


@pytest.mark.parametrize(
    "claim", [RelayRequest("bob/brain"), RelayRequest("bob/brain", user="bob")], ids=["silent", "as the other"]
)
async def test_environment_cannot_reach_environment_of_another_user(
    west: Machine, east: Machine, claim: RelayRequest
) -> None:
    request = RelayRequest(claim.to, west.address, claim.user)
    reader, writer = await east.call_from("ann/eye", request)
    assert await reason(reader) == "another user's"
    writer.close()


async def test_link_for_another_user_is_refused_by_the_remote_relay(west: Machine) -> None:
    reader, writer = await west.call(RelayRequest("bob/brain", user="ann"))
    assert await reason(reader) == "another user's"
    writer.close()


async def test_environment_reaches_known_relays_only(west: Machine, east: Machine) -> None:
    """No other address in the network of its machine is reachable through the relay."""
    served = 0

    async def victim(reader: Reader, writer: Writer) -> None:
        nonlocal served
        served += 1
        writer.close()

    async with await asyncio.start_server(victim, "127.0.0.1", 0) as server:
        number = server.sockets[0].getsockname()[1]
        for address in (f"127.0.0.1:{number}", f"localhost:{number}", "", "nonsense"):
            reader, writer = await east.call_from("ann/eye", RelayRequest("ann/brain", address))
            assert await reason(reader) == "no such relay", address
            writer.close()
    assert not served


@pytest.mark.parametrize(
    ("first", "answer"),
    [
        (RelayRequest("ann/other").line(), "not here"),
        (RelayRequest("").line(), "not here"),
        (b"GET / HTTP/1.1\r\n", "not understood"),
        (b"\xff" * 5000, "not understood"),
    ],
    ids=["unknown", "nobody", "http", "no end"],
)
async def test_invalid_requests_are_refused(west: Machine, first: bytes, answer: str) -> None:
    reader, writer = await west.call(first)
    assert await reason(reader) == answer
    writer.close()


async def test_symbolic_link_to_another_socket_is_not_followed(west: Machine, tmp_path: Path) -> None:
    """An environment could replace its socket by a link to one that only the task set may open."""
    with bind_unix_socket(tmp_path / "privileged") as privileged:
        privileged.listen()
        privileged.setblocking(False)
        socket = west.directory / "ann" / "brain" / "data.sock"
        socket.unlink()
        socket.symlink_to(tmp_path / "privileged")
        reader, writer = await west.call(RelayRequest("ann/brain"))
        assert await reason(reader) == "out of reach"
        writer.close()
        with pytest.raises(BlockingIOError):
            privileged.accept()


async def test_removing_an_environment_closes_its_links(west: Machine, east: Machine) -> None:
    to, writer_to = await west.call(RelayRequest("ann/brain"))
    of, writer_of = await east.call_from("ann/eye", RelayRequest("ann/brain", west.address))
    for reader, writer in ((to, writer_to), (of, writer_of)):
        writer.write(b"a\n")
        assert await received(reader) == b"ann/brain: a\n"
    east.relay.remove_environment("ann/eye")
    assert await reason(of) == ""
    west.relay.remove_environment("ann/brain")
    assert await reason(to) == ""
    reader, writer = await west.call(RelayRequest("ann/brain"))
    assert await reason(reader) == "not here"
    for each in (writer, writer_to, writer_of):
        each.close()


async def test_links_and_pending_callers_are_limited(west: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_LINKS", 2)
    monkeypatch.setattr(module, "MAX_PENDING", 1)
    held = []
    for _ in range(2):
        reader, writer = await west.call(RelayRequest("ann/brain").line() + b"a\n")
        assert await received(reader)
        held.append(writer)
    reader, writer = await west.call(RelayRequest("ann/brain"))
    assert await reason(reader) == "too many links"
    writer.close()
    await assert_connected_to("bob/brain", *await west.call(RelayRequest("bob/brain")))
    _, silent = await west.call(b"")
    async with asyncio.timeout(WAIT):
        while not west.relay._pending:  # noqa: ASYNC110  # the relay accepts it in its own time
            await asyncio.sleep(0.001)
    reader, writer = await west.call(b"")
    assert await reason(reader) == "too many links"
    for each in (writer, silent, *held):
        each.close()


async def test_silent_caller_is_disconnected_and_unreachable_relay_is_reported(
    west: Machine, east: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(module, "TIMEOUT", 0.05)
        reader, writer = await west.call(b"")
        assert await reason(reader) == ""
        writer.close()
    await west.relay.close()
    reader, writer = await east.call_from("ann/eye", RelayRequest("ann/brain", west.address))
    assert await reason(reader) == "out of reach"
    writer.close()


async def test_back_pressure_reaches_the_sender(west: Machine) -> None:
    """The relay buffers a bounded amount, however much is sent."""
    _, writer = await west.call(RelayRequest("ann/brain"))
    sent = 0

    async def flood() -> None:
        nonlocal sent
        while True:
            writer.write(b"y" * 999_999 + b"\n")  # the answers are not read
            sent += 1
            await writer.drain()

    task = asyncio.create_task(flood())
    before = -1
    while sent > before:  # megabytes
        before = sent
        await asyncio.sleep(0.5)
    task.cancel()
    assert sent < 100  # most of it in the buffers of the kernel and of both ends
    writer.transport.abort()


def test_listening_on_all_addresses_needs_data_address() -> None:
    with pytest.raises(InvalidRequest, match="data_address"):
        asyncio.run(DataRelay().listen("0.0.0.0", 0))
