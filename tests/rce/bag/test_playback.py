"""Messages of a playback."""

from __future__ import annotations

import json

import msgspec

from rce.bag.playback import PlaybackRequest, PlaybackState, encode


def test_messages_are_json_without_what_is_not_said() -> None:
    assert json.loads(encode(PlaybackRequest(True))) == {"play": True}
    state = PlaybackState("paused", 5, 0.5, 1, 9, "r", seeked=True)
    assert msgspec.json.decode(encode(state), type=PlaybackState) == state
