"""Velocity commands beside images."""

from __future__ import annotations

import asyncio
import json
import time
from contextlib import AsyncExitStack
from typing import Any, cast

import pytest

from rce.bench import overtake
from rce.bench.overtake import COMMAND, SIZE, Command, CommandStream, Flood, Result
from rce.bench.payloads import ROW
from rce.client import Publisher, Subscriber
from tests.support.bench import Topic, fake_place


@pytest.fixture(autouse=True)
def no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(overtake, "PAUSE", (0.0, 0.0))


def node() -> tuple[Topic, Topic]:
    """Return commands and arrivals of a node that answers each command at once."""
    arrivals = Topic()

    def answer(message: Any) -> None:
        arrivals.messages.append({"data": time.monotonic()})

    return Topic(answer), arrivals


async def test_command_has_the_times_of_its_arrival_and_answer() -> None:
    commands, arrivals = node()
    stream = CommandStream(cast(Publisher, commands), cast(Subscriber, arrivals))
    await stream.wait_for_node()
    taken = await stream.measure(3)
    assert commands.sent == [COMMAND] * 4
    assert all(0 <= each.there <= each.back for each in taken)


async def test_images_flow_once_the_queues_are_filled() -> None:
    images = Topic()
    flood = Flood(cast(Publisher, images))
    sending = asyncio.create_task(flood.send())
    await asyncio.wait_for(flood.flowing.wait(), 20)
    sending.cancel()
    assert flood.sent >= 20
    assert len(images.sent[0]) > SIZE
    assert SIZE % ROW == 0


async def test_commands_are_measured_alone_and_beside_images() -> None:
    async with AsyncExitStack() as stack:
        place, environment, _ = fake_place(stack)
        commands, arrivals = node()
        images = Topic()
        environment.topics = {"/command": commands, "/arrival": arrivals, "/image": images}
        result = await overtake.measure(place, 2)
    assert (len(result.alone), len(result.beside)) == (2, 2)
    assert len(images.sent) >= 20
    assert [entry[2:4] for entry in environment.log] == [("commands", "commands"), ("images", "images")]


RESULT = Result([Command(0.001, 0.002)] * 3, [Command(0.004, 0.01)] * 3, 12.34)


def test_table_is_in_milliseconds() -> None:
    _, alone, beside, rate = overtake.as_text(RESULT).splitlines()
    assert alone.split() == ["alone", "1.00", "1.00", "1.00", "2.00", "2.00", "2.00"]
    assert beside.split() == ["beside", "10", "MB", "images", "4.00", "4.00", "4.00", "10.00", "10.00", "10.00"]
    assert rate == "12.3 images a second"


def test_data_has_all_samples() -> None:
    data = json.loads(json.dumps(overtake.as_data(RESULT)))["overtake"]
    assert data == {"alone": [[0.001, 0.002]] * 3, "beside": [[0.004, 0.01]] * 3, "rate": 12.34}
