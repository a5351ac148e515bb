"""Time and playback control of a Foxglove client."""

from __future__ import annotations

import json
import struct
from typing import Any

import pytest

from endpoints.gateways.foxglove.messages import PlaybackCommand
from endpoints.gateways.foxglove.playback import CLOCK, CLOCK_TYPE, Playback
from rce.bag.playback import CONTROL, STATE, TYPE, PlaybackState, encode
from rce.control.calls.watching import RosGraph, RosName
from rce.errors import Forbidden, InvalidRequest, RceError
from tests.support.endpoints.fake_guest import FakeGuest

EMPTY = RosGraph([], [])
CLOCKED = RosGraph([RosName(CLOCK, [CLOCK_TYPE], 1)], [])
PLAYED = RosGraph([RosName(CLOCK, [CLOCK_TYPE], 1), RosName(STATE, [TYPE], 1)], [])
STATE_OF_PLAY = PlaybackState("playing", 7, 1.0, 5, 9)


class Client:
    def __init__(self, guest: FakeGuest) -> None:
        self.guest = guest
        self.errors: list[RceError] = []
        self.playback = Playback(guest.as_guest(), self._greet, self.errors.append)

    def _greet(self, state: PlaybackState | None) -> bytes:
        return json.dumps({"playback": state is not None}).encode()

    def told(self, state: PlaybackState) -> list[Any]:
        use = self.guest.uses["SubscriberInterface", STATE]
        return self.guest.deliver(use, {"data": encode(state)})


@pytest.fixture
def client(guest: FakeGuest) -> Client:
    return Client(guest)


async def test_clock_becomes_time(client: Client, guest: FakeGuest) -> None:
    client.playback.update(EMPTY)
    assert not guest.uses
    client.playback.update(CLOCKED)
    use = guest.uses["SubscriberInterface", CLOCK]
    stamp = struct.pack("<BQ", 2, 5_000_000_007)
    assert guest.deliver(use, None, blob=b"\0\1\0\0" + struct.pack("<iI", 5, 7)) == [stamp]
    assert guest.deliver(use, None, blob=b"\0\0\0\0" + struct.pack(">iI", 5, 7)) == [stamp]
    assert guest.deliver(use, None, blob=b"\0\1\0") == []
    client.playback.update(EMPTY)
    assert guest.dropped == [CLOCK]


async def test_playback_is_announced_followed_and_withdrawn(client: Client, guest: FakeGuest) -> None:
    client.playback.update(PLAYED)
    stamp = struct.pack("<BQ", 2, 7)
    first = client.told(STATE_OF_PLAY)
    assert first == [{"playback": True}, stamp, struct.pack("<BBQfBI", 5, 0, 7, 1.0, 0, 0)]
    assert client.told(STATE_OF_PLAY) == [stamp]
    answer = client.told(PlaybackState("paused", 7, 2.0, 5, 9, "id", seeked=True))
    assert answer[1] == struct.pack("<BBQfBI", 5, 1, 7, 2.0, 1, 2) + b"id"
    clock = guest.uses["SubscriberInterface", CLOCK]
    assert guest.deliver(clock, None, blob=b"\0\1\0\0" + bytes(8)) == []  # one time is enough
    client.playback.update(CLOCKED)
    assert guest.frames[-1] == {"playback": False}


async def test_nonsense_on_the_topic_is_ignored(client: Client, guest: FakeGuest) -> None:
    client.playback.update(PLAYED)
    assert guest.deliver(guest.uses["SubscriberInterface", STATE], {"data": "?"}) == []


async def test_command_reaches_the_playback(client: Client, guest: FakeGuest) -> None:
    command = PlaybackCommand(True, 2.0, 8, "id")
    with pytest.raises(InvalidRequest, match="rce bag play"):
        client.playback.control(command)
    client.playback.update(PLAYED)
    client.told(STATE_OF_PLAY)
    client.playback.control(command)
    client.playback.control(command)
    await guest.finish()
    (address, _, value, _), _ = guest.sent
    assert (address, json.loads(value["data"])) == (CONTROL, {"play": True, "speed": 2.0, "seek": 8, "id": "id"})


async def test_client_that_may_only_read_cannot_control(client: Client, guest: FakeGuest) -> None:
    client.playback.update(PLAYED)
    client.told(STATE_OF_PLAY)
    guest.fails = Forbidden("data.write")
    client.playback.control(PlaybackCommand(False, 1.0, None, ""))
    await guest.finish()
    assert [str(error) for error in client.errors] == ["data.write"]


async def test_command_is_refused_while_too_much_is_in_progress(client: Client, guest: FakeGuest) -> None:
    client.playback.update(PLAYED)
    client.told(STATE_OF_PLAY)
    client.playback.control(PlaybackCommand(True, 1.0, None, "r"))
    guest.full = True
    await guest.finish()
    assert [str(error) for error in client.errors] == ["too many operations are in progress"]
    guest.full = False
    client.playback.control(PlaybackCommand(True, 1.0, None, "r"))
    await guest.finish()
    assert ("PublisherInterface", CONTROL) in guest.uses
