"""The message of a publisher that does not wait."""

from __future__ import annotations

import pytest

from rce.client.backlog import Backlog, Encoded


def message(number: int) -> Encoded:
    return Encoded(str(number).encode(), {})


def drained(backlog: Backlog) -> list[int]:
    found = []
    while (first := backlog.first()) is not None:
        found.append(int(first.text))
        backlog.remove(first)
    return found


@pytest.mark.parametrize(("keep", "kept", "dropped"), [(False, [], 3), (True, [2], 2)])
def test_messages_that_cannot_be_sent(keep: bool, kept: list[int], dropped: int) -> None:
    backlog = Backlog(keep=keep)
    for number in range(3):
        backlog.put(message(number), possible=False)
    assert drained(backlog) == kept
    assert backlog.dropped == dropped


def test_loss_of_the_connection_drops_what_is_not_kept() -> None:
    for keep, kept in ((False, []), (True, [5])):
        backlog = Backlog(keep=keep)
        backlog.put(message(5), possible=True)
        backlog.disconnected()
        assert drained(backlog) == kept
        assert backlog.dropped == 1 - len(kept)


def test_message_that_gave_way_while_it_was_sent_is_not_removed_twice() -> None:
    backlog = Backlog(keep=True)
    backlog.put(message(1), possible=True)
    sending = backlog.first()
    assert sending is not None
    backlog.put(message(2), possible=True)
    backlog.remove(sending)
    assert drained(backlog) == [2]


def test_old_message_is_dropped() -> None:
    backlog = Backlog(keep=True)
    backlog.put(message(1), possible=True, until=10.0)
    backlog.drop_old(10.0)
    assert backlog
    backlog.drop_old(10.5)
    assert not backlog
    assert backlog.dropped == 1
