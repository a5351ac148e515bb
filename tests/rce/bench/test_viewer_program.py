"""Program with the viewers of a camera."""

from __future__ import annotations

from typing import Any, cast

from msgspec import Raw

from rce.bench.viewer_program import Seen, Task, Viewers
from rce.client import Subscriber
from rce.client.connection import Message
from rce.protocol.messages import DataMessage


class Receiver:
    """Subscriber whose messages the test gives it."""

    _receive: Any = None


def message(blob: str) -> Message:
    return Message(DataMessage("in", "sensor_msgs/Image", "nil", blob=Raw(b'"x"')), {blob: b"12345"})


def test_message_that_many_viewers_get_is_encoded_once() -> None:
    viewers, receivers = Viewers(Task(2)), [Receiver(), Receiver()]
    for each in receivers:
        viewers.watch(cast(Subscriber, each))
    for blob in ("a", "b"):
        for each in receivers:
            each._receive(message(blob))
    assert viewers.seen() == Seen(messages=4, bytes=20, encoded=2)


def test_what_other_viewers_have_seen_is_added() -> None:
    seen = Seen(messages=4, bytes=20, encoded=2)
    seen.add(Seen(messages=1, bytes=5, encoded=1))
    assert seen == Seen(messages=5, bytes=25, encoded=3)
