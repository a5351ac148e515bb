"""Messages of a playback."""

from __future__ import annotations

import json
import re

import msgspec
import pytest

from rce.bag.playback import PlaybackRequest, PlaybackState, encode
from rce.errors import MALFORMED


def test_messages_are_json_without_what_is_not_said() -> None:
    assert json.loads(encode(PlaybackRequest(True))) == {"play": True}
    state = PlaybackState("paused", 5, 0.5, 1, 9, "r", seeked=True)
    assert msgspec.json.decode(encode(state), type=PlaybackState) == state


@pytest.mark.parametrize("field", ['"time": 1180591620717411303424', '"time": -1', '"speed": 1e300', '"speed": 0'])
def test_states_that_nobody_can_show_are_malformed(field: str) -> None:
    text = encode(PlaybackState("paused", 5, 0.5, 1, 9))
    name = field.partition(":")[0]
    with pytest.raises(MALFORMED):
        msgspec.json.decode(re.sub(rf"{name}:[^,]*", field, text), type=PlaybackState)
