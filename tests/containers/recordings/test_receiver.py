"""Receiver of recordings, with the environment's side of the transfer."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from containers.recordings.receiver import RecordingReceiver
from containers.recordings.store import MAGIC, RecordingStore
from rce.bag.reader import summarize
from rce.bag.transfer import SOCKET, Broken, StoredFile
from rce.bag.writer import BagWriter, Topic
from rce.control.calls.recordings import RecordingQuota
from rce.errors import LimitExceeded, NotFound, RceError, Unavailable
from rce.net.sockets import unix_socket_path

NAME = "ann/brain"
STRING = Topic("/say", "std_msgs/msg/String", "string data\n")


class Machine:
    """A machine with one environment, whose Master answers `quota`, or `refusal` if there is one."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.store = RecordingStore(directory / "recordings")
        self.receiver = RecordingReceiver(self.store)
        self.receiver.ask_quota = self._ask
        self.quota = RecordingQuota()
        self.refusal: RceError | None = None
        self.asked: list[tuple[str, str]] = []

    async def _ask(self, environment: str, recorder: str) -> RecordingQuota:
        self.asked.append((environment, recorder))
        if self.refusal is not None:
            raise self.refusal
        return self.quota

    async def open(self) -> StoredFile:
        return await asyncio.to_thread(StoredFile, self.directory / SOCKET, "box")

    async def states(self, *wanted: str) -> None:
        """Wait until the recordings have these states."""
        async with asyncio.timeout(30):
            while [each.state for each in self.store.of("ann")] != list(wanted):  # noqa: ASYNC110  # no event
                await asyncio.sleep(0.01)


@pytest.fixture
async def machine(tmp_path: Path) -> AsyncIterator[Machine]:
    machine = Machine(tmp_path)
    machine.receiver.add_environment(NAME, tmp_path)
    yield machine
    await machine.receiver.close()


async def test_recording_of_an_environment_is_stored(machine: Machine) -> None:
    def work() -> None:
        writer = BagWriter(Path("recording"), create=lambda _: StoredFile(machine.directory / SOCKET, "box"))
        for number in range(1000):
            writer.put(STRING, number.to_bytes(4), number)
        writer.close({})

    await asyncio.to_thread(work)
    await machine.states("complete")
    assert machine.asked == [(NAME, "box")]
    (found,) = machine.store.of("ann")
    summary = summarize(machine.store.path(found.id))
    assert (summary.complete, summary.counts) == (True, {"/say": 1000})


async def test_recording_whose_environment_is_killed_is_cut_off(machine: Machine) -> None:
    file = await machine.open()
    file.write(MAGIC + b"something")
    file._socket.close()
    await machine.states("cut off")


async def test_quota_ends_a_recording_with_its_reason(machine: Machine) -> None:
    machine.quota = RecordingQuota(5_000_000)
    file = await machine.open()

    def fill() -> None:
        for _ in range(100):
            file.write(bytes(1_000_000))

    with pytest.raises(LimitExceeded, match="recordings"):
        await asyncio.to_thread(fill)
    file._socket.close()
    await machine.states("cut off")
    assert machine.store.of("ann")[0].size <= 5_000_000


@pytest.mark.parametrize(
    ("refusal", "expected"),
    [(NotFound("no such recorder"), NotFound), (Unavailable("the Master is away"), Broken)],
)
async def test_recorder_that_the_master_refuses_may_not_record(
    machine: Machine, refusal: RceError, expected: type[RceError]
) -> None:
    machine.refusal = refusal
    with pytest.raises(expected):
        await machine.open()
    assert machine.store.of("ann") == []


async def test_removed_environment_ends_its_recordings(machine: Machine) -> None:
    file = await machine.open()
    machine.receiver.remove_environment(NAME)
    await machine.states("cut off")
    with pytest.raises(Broken):
        await asyncio.to_thread(file.close)
    with pytest.raises(Broken):
        await machine.open()


async def test_connection_that_says_nothing_sensible_is_closed(machine: Machine) -> None:
    def talk() -> bytes:
        with socket.socket(socket.AF_UNIX) as connection, unix_socket_path(machine.directory / SOCKET) as path:
            connection.settimeout(30)
            connection.connect(path)
            connection.sendall(bytes(20_000))
            return connection.recv(10)

    assert await asyncio.to_thread(talk) == b""
    assert machine.asked == []


async def test_receiver_without_a_store_opens_nothing(tmp_path: Path) -> None:
    receiver = RecordingReceiver()
    receiver.add_environment(NAME, tmp_path)
    assert not receiver.active
    assert not (tmp_path / SOCKET).exists()
