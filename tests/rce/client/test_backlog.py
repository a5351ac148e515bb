"""Messages of publishers that do not wait."""

from __future__ import annotations

import pytest

from rce.client import backlog as module
from rce.client.backlog import Backlog, Encoded, Offline
from rce.errors import InvalidRequest


def message(number: int) -> Encoded:
    return Encoded(str(number).encode(), {})


def drained(backlog: Backlog) -> list[int]:
    found = []
    while (first := backlog.first()) is not None:
        found.append(int(first.text))
        backlog.remove(first)
    return found


@pytest.mark.parametrize(("offline", "kept", "dropped"), [("drop", [], 3), ("newest", [2], 2), ("store", [0, 1, 2], 0)])
def test_messages_that_cannot_be_sent(offline: Offline, kept: list[int], dropped: int) -> None:
    backlog = Backlog(offline)
    for number in range(3):
        backlog.put(message(number), possible=False)
    assert drained(backlog) == kept
    assert backlog.dropped == dropped


def test_store_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_MESSAGES", 3)
    monkeypatch.setattr(module, "MOST_BYTES", 10)
    backlog = Backlog("store")
    for number in (*range(5), 1234567, 12345678901):
        backlog.put(message(number), possible=False)
    assert drained(backlog) == [12345678901]
    assert backlog.dropped == 6


def test_loss_of_the_connection_drops_what_is_not_kept() -> None:
    for offline, kept in (("drop", []), ("newest", [5]), ("store", [5])):
        backlog = Backlog(offline)  # type: ignore[arg-type]
        backlog.put(message(5), possible=True)
        backlog.disconnected()
        assert drained(backlog) == kept


def test_message_that_gave_way_while_it_was_sent_is_not_removed_twice() -> None:
    backlog = Backlog("newest")
    backlog.put(message(1), possible=True)
    sending = backlog.first()
    assert sending is not None
    backlog.put(message(2), possible=True)
    backlog.remove(sending)
    assert drained(backlog) == [2]


def test_misspelt_choice_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="offline='newst': write drop, newest, store"):
        Backlog("newst")  # type: ignore[arg-type]


def test_messages_that_are_of_no_use_any_more_are_dropped() -> None:
    backlog = Backlog("store")
    for number in range(3):
        backlog.put(message(number), possible=False, until=10.0 + number)
    backlog.drop_old(11.5)
    assert drained(backlog) == [2]
    assert backlog.dropped == 2
