"""The data relay: whom it takes where, whom it refuses and why, and its bounds."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import pytest

from containers import data_relay as module
from containers.data_relay import GATE, DataRelay
from rce.errors import InvalidRequest
from rce.metrics import Counter, Sample
from rce.passage import Passage, refused
from rce.sockets import bound, reaching

Reader = asyncio.StreamReader
Writer = asyncio.StreamWriter
WAIT = 20.0


class Machine:
    """A relay with environments that answer every line with their name and the line."""

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
        place = self.directory / name
        place.mkdir(parents=True)

        async def answer(reader: Reader, writer: Writer) -> None:
            with suppress(ConnectionError):
                while line := await reader.readline():
                    writer.write(f"{name}: ".encode() + line)
                    await writer.drain()
            writer.close()

        listener = bound(place / "data.sock")
        self._servers.append(await asyncio.start_unix_server(answer, sock=listener, limit=4_000_000))
        await self.relay.admit(name, place / "data.sock", place)

    async def stop(self) -> None:
        await self.relay.close()
        for server in self._servers:
            server.close()

    @property
    def address(self) -> str:
        return self.relay.address.removeprefix("relay:")

    async def call(self, passage: Passage | bytes) -> tuple[Reader, Writer]:
        """Call from another machine."""
        host, _, port = self.address.rpartition(":")
        reader, writer = await asyncio.open_connection(host, int(port), limit=4_000_000)
        writer.write(passage if isinstance(passage, bytes) else passage.line())
        return reader, writer

    async def call_from(self, name: str, passage: Passage) -> tuple[Reader, Writer]:
        """Call as an environment of this machine does."""
        with reaching(self.directory / name / GATE) as path:
            reader, writer = await asyncio.open_unix_connection(path, limit=4_000_000)
        writer.write(passage.line())
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
        one.relay.know([west.address, machine.address])
    yield machine
    await machine.stop()


async def said(reader: Reader) -> bytes:
    return await asyncio.wait_for(reader.readline(), WAIT)


async def reason(reader: Reader) -> str:
    """The relay's refusal, after which it closes; empty if it closes without."""
    try:
        return refused(await asyncio.wait_for(reader.read(), WAIT))
    except ConnectionError:
        return ""


async def talks(reader: Reader, writer: Writer, name: str) -> None:
    writer.write(b"again\n")
    assert await said(reader) == f"{name}: again\n".encode()
    writer.close()


async def test_from_another_machine_to_an_environment(west: Machine) -> None:
    for passage in (Passage("ann/brain"), Passage("ann/brain", user="ann")):
        reader, writer = await west.call(passage.line() + b"early\n")
        assert await said(reader) == b"ann/brain: early\n"
        large = b"x" * 3_000_000 + b"\n"
        writer.write(large)
        assert await said(reader) == b"ann/brain: " + large
        writer.close()


async def test_what_passes_is_counted(west: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_passed", Counter("rce_relay_bytes", ""))
    monkeypatch.setattr(module, "_refusals", Counter("rce_relay_refusals", "", "reason"))
    reader, writer = await west.call(Passage("ann/brain"))
    writer.write(b"hello\n")
    assert await reader.readline() == b"ann/brain: hello\n"
    (family,) = west.relay.families()
    assert {tuple(each.labels): each.value for each in family.samples} == {("asking",): 0, ("taken",): 1}
    assert module._passed.family().samples == [Sample([], len("hello\n") + len("ann/brain: hello\n"))]
    refused_reader, _ = await west.call(Passage("ann/nobody"))
    await refused_reader.read()
    assert module._refusals.family().samples == [Sample(["not here"], 1)]
    writer.close()


async def test_a_line_that_comes_in_parts(west: Machine) -> None:
    reader, writer = await west.call(b"")
    for byte in Passage("ann/brain").line():
        writer.write(bytes([byte]))
        await asyncio.sleep(0)
    await talks(reader, writer, "ann/brain")


async def test_from_an_environment_to_one_of_its_user_on_another_machine(west: Machine, east: Machine) -> None:
    await talks(*await east.call_from("ann/eye", Passage("ann/brain", west.address)), "ann/brain")


@pytest.mark.parametrize(
    "claim", [Passage("bob/brain"), Passage("bob/brain", user="bob")], ids=["silent", "as the other"]
)
async def test_an_environment_is_not_taken_to_another_users(west: Machine, east: Machine, claim: Passage) -> None:
    passage = Passage(claim.to, west.address, claim.user)
    reader, writer = await east.call_from("ann/eye", passage)
    assert await reason(reader) == "another user's"
    writer.close()


async def test_a_relay_does_not_believe_the_caller_whose_environment_it_is_for(west: Machine) -> None:
    reader, writer = await west.call(Passage("bob/brain", user="ann"))
    assert await reason(reader) == "another user's"
    writer.close()


async def test_an_environment_is_taken_to_known_relays_only(west: Machine, east: Machine) -> None:
    """Not to any other address in the network of its machine."""
    served = 0

    async def victim(reader: Reader, writer: Writer) -> None:
        nonlocal served
        served += 1
        writer.close()

    async with await asyncio.start_server(victim, "127.0.0.1", 0) as server:
        number = server.sockets[0].getsockname()[1]
        for address in (f"127.0.0.1:{number}", f"localhost:{number}", "", "nonsense"):
            reader, writer = await east.call_from("ann/eye", Passage("ann/brain", address))
            assert await reason(reader) == "no such relay", address
            writer.close()
    assert not served


@pytest.mark.parametrize(
    ("first", "answer"),
    [
        (Passage("ann/other").line(), "not here"),
        (Passage("").line(), "not here"),
        (b"GET / HTTP/1.1\r\n", "not understood"),
        (b"\xff" * 5000, "not understood"),
    ],
    ids=["unknown", "nobody", "http", "no end"],
)
async def test_what_leads_nowhere(west: Machine, first: bytes, answer: str) -> None:
    reader, writer = await west.call(first)
    assert await reason(reader) == answer
    writer.close()


async def test_a_link_to_other_sockets_of_the_host_is_not_followed(west: Machine, tmp_path: Path) -> None:
    """An environment may replace its own socket: by one that the task set may open and it may not."""
    with bound(tmp_path / "privileged") as privileged:
        privileged.listen()
        privileged.setblocking(False)
        socket = west.directory / "ann" / "brain" / "data.sock"
        socket.unlink()
        socket.symlink_to(tmp_path / "privileged")
        reader, writer = await west.call(Passage("ann/brain"))
        assert await reason(reader) == "out of reach"
        writer.close()
        with pytest.raises(BlockingIOError):
            privileged.accept()


async def test_an_environment_that_ends_takes_its_links_along(west: Machine, east: Machine) -> None:
    to, writer_to = await west.call(Passage("ann/brain"))
    of, writer_of = await east.call_from("ann/eye", Passage("ann/brain", west.address))
    for reader, writer in ((to, writer_to), (of, writer_of)):
        writer.write(b"a\n")
        assert await said(reader) == b"ann/brain: a\n"
    east.relay.dismiss("ann/eye")
    assert await reason(of) == ""
    west.relay.dismiss("ann/brain")
    assert await reason(to) == ""
    reader, writer = await west.call(Passage("ann/brain"))
    assert await reason(reader) == "not here"
    for each in (writer, writer_to, writer_of):
        each.close()


async def test_bounds(west: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LINKS", 2)
    monkeypatch.setattr(module, "STRANGERS", 1)
    held = []
    for _ in range(2):
        reader, writer = await west.call(Passage("ann/brain").line() + b"a\n")
        assert await said(reader)
        held.append(writer)
    reader, writer = await west.call(Passage("ann/brain"))
    assert await reason(reader) == "too many links"
    writer.close()
    await talks(*await west.call(Passage("bob/brain")), "bob/brain")
    _, silent = await west.call(b"")
    await asyncio.sleep(0.01)
    reader, writer = await west.call(b"")
    assert await reason(reader) == "too many links"
    for each in (writer, silent, *held):
        each.close()


async def test_who_says_nothing_is_sent_away_and_a_dead_relay_is_told(
    west: Machine, east: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PATIENCE", 0.05)
    reader, writer = await west.call(b"")
    assert await reason(reader) == ""
    writer.close()
    await west.relay.close()
    reader, writer = await east.call_from("ann/eye", Passage("ann/brain", west.address))
    assert await reason(reader) == "out of reach"
    writer.close()


async def test_one_side_that_does_not_read_makes_the_other_wait(west: Machine) -> None:
    """The memory of the relay stays bounded, whatever is sent."""
    _, writer = await west.call(Passage("ann/brain"))
    sent = 0

    async def flood() -> None:
        nonlocal sent
        while True:
            writer.write(b"y" * 999_999 + b"\n")  # what comes back is not read
            sent += 1
            await writer.drain()

    task = asyncio.create_task(flood())
    before = -1
    while sent > before:  # megabytes
        before = sent
        await asyncio.sleep(0.5)
    task.cancel()
    assert sent < 100  # a good part of it with both ends and the kernel
    writer.transport.abort()


def test_an_address_for_all_addresses_must_be_said() -> None:
    with pytest.raises(InvalidRequest, match="data_address"):
        asyncio.run(DataRelay().listen("0.0.0.0", 0))
