from __future__ import annotations

from rce.mapping3d.offload.messages import FORMAT, decode
from rce.mapping3d.offload.outbox import Outbox
from rce.mapping3d.offload.sending import PATIENCE, WINDOW, Sending
from tests.support.key_frames import key_frame

SECOND = 1_000_000


def filled(count: int) -> Outbox:
    outbox = Outbox(1 << 30)
    for index in range(count):
        outbox.add(key_frame(index))
    return outbox


def indices(sending: Sending, outbox: Outbox, now: float) -> list[int]:
    found = list(sending.due(outbox, now))
    assert all(format == FORMAT for _, format, _ in found)
    return [decode(data).index for _, _, data in found]


def test_few_key_frames_are_unanswered_at_a_time() -> None:
    sending, outbox = Sending(1e12), filled(8)
    assert indices(sending, outbox, 0.0) == list(range(WINDOW))
    assert indices(sending, outbox, 0.1) == []
    sending.answered(outbox, 0, 0.2)
    sending.answered(outbox, 12345, 0.2)
    assert indices(sending, outbox, 0.2) == [WINDOW]
    assert len(outbox) == 7


def test_line_is_not_used_beyond_its_rate() -> None:
    sending, outbox = Sending(1000.0), filled(4)
    assert indices(sending, outbox, 0.0) == [0]
    need = sending.sent / 1000.0
    assert indices(sending, outbox, 0.9 * need) == []
    assert indices(sending, outbox, 1.1 * need) == [1]


def test_what_is_not_answered_is_sent_again() -> None:
    sending, outbox = Sending(1e12), filled(2)
    assert indices(sending, outbox, 0.0) == [0, 1]
    sending.answered(outbox, 0, 1.0)
    assert indices(sending, outbox, 1.0 + PATIENCE - 0.1) == []
    assert indices(sending, outbox, 1.0 + PATIENCE + 0.1) == [1]
    sending.restart()
    assert indices(sending, outbox, 1.0 + PATIENCE + 0.2) == [1]
