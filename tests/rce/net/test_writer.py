"""Writer that joins small writes."""

from __future__ import annotations

import asyncio
from unittest.mock import Mock

import pytest

from rce.net.writer import MOST, SMALL, Passes, Writer


class Transport(Mock):
    """Transport that records each write.

    Attributes:
        writes: The bytes of each write.
        closing: True once it is closed.
    """

    writes: list[bytes]
    closing = False

    def writelines(self, buffers: list[bytes]) -> None:
        self.writes.append(b"".join(buffers))

    def is_closing(self) -> bool:
        return self.closing


@pytest.fixture
async def transport() -> Transport:
    return Transport(writes=[])


@pytest.fixture
def writer(transport: Transport) -> Writer:
    return Writer(transport, Passes())


async def test_small_writes_of_one_pass_are_joined_after_the_first(transport: Transport, writer: Writer) -> None:
    assert [writer.write([text, b"!"]) for text in (b"one", b"two", b"three")] == [True, False, False]
    assert transport.writes == [b"one!"]
    await asyncio.sleep(0)
    assert transport.writes == [b"one!", b"two!three!"]


async def test_write_of_a_later_pass_goes_out_at_once(transport: Transport, writer: Writer) -> None:
    for text in (b"one", b"two"):
        writer.write([text])
        await asyncio.sleep(0)
    assert transport.writes == [b"one", b"two"]


async def test_write_after_a_joined_one_waits_for_its_pass_too(transport: Transport, writer: Writer) -> None:
    writer.write([b"one"])
    writer.write([b"two"])
    await asyncio.sleep(0)
    assert not writer.write([b"three"])
    await asyncio.sleep(0)
    assert transport.writes == [b"one", b"two", b"three"]


@pytest.mark.parametrize("size", [SMALL, MOST])
async def test_large_write_does_not_wait(transport: Transport, writer: Writer, size: int) -> None:
    writer.write([b"one"])
    writer.write([b"two"])
    assert writer.write([bytes(size)])
    assert transport.writes == [b"one", b"two", bytes(size)]


async def test_small_write_after_a_large_one_does_not_wait(transport: Transport, writer: Writer) -> None:
    writer.write([bytes(SMALL)])
    assert writer.write([b"one"])
    assert transport.writes == [bytes(SMALL), b"one"]


async def test_no_more_than_a_few_bytes_wait(transport: Transport, writer: Writer) -> None:
    written = [writer.write([bytes(SMALL - 1)]) for _ in range(6)]
    assert written == [True, False, False, False, False, True]
    assert sum(map(len, transport.writes)) == 6 * (SMALL - 1)


async def test_flush_writes_in_order_before_others_write(transport: Transport, writer: Writer) -> None:
    writer.write([b"one"])
    writer.write([b"two"])
    writer.flush()
    transport.writelines([b"close"])
    await asyncio.sleep(0)
    assert transport.writes == [b"one", b"two", b"close"]


async def test_nothing_is_written_to_a_closed_transport(transport: Transport, writer: Writer) -> None:
    writer.write([b"one"])
    writer.write([b"two"])
    transport.closing = True
    await asyncio.sleep(0)
    assert transport.writes == [b"one"]


async def test_writers_of_one_loop_are_joined_each_by_itself(transport: Transport) -> None:
    passes, other = Passes(), Transport(writes=[])
    one, two = Writer(transport, passes), Writer(other, passes)
    for writer in (one, one, two, two):
        writer.write([b"x"])
    assert transport.writes == other.writes == [b"x"]
    await asyncio.sleep(0)
    assert transport.writes == other.writes == [b"x", b"x"]
    one.write([b"y"])  # in the pass in which the others went out
    await asyncio.sleep(0)
    one.write([b"z"])
    assert transport.writes == [b"x", b"x", b"y"]
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert one.write([b"last"]), "nothing was written in this pass"
