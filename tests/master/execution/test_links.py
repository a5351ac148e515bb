"""Links that break: when they are opened again, and which reports are ignored."""

from __future__ import annotations

from master.execution import links
from rce.control.calls.call import Nothing
from rce.control.calls.endpoints import AddRoute, CloseLink, LinkLost, OpenLink
from rce.protocol import messages as m
from tests.support.master.desk import Desk, Peer


def opened(peer: Peer) -> list[str]:
    return [call.link.name for call in peer.got(OpenLink)]


def lose(desk: Desk, process: str, link: str) -> None:
    report = desk.hand.begin(desk.master._links.lost(desk.state.processes[process], LinkLost(link, "broke")))
    assert report.result() == Nothing()


def test_lost_link_is_replaced_at_once_at_both_ends(desk: Desk) -> None:
    west, brain = desk.wired()
    (old,) = opened(west)
    lose(desk, "west", old)
    (_, new) = opened(west)
    assert new != old
    assert opened(brain) == [old, new]
    for peer in (west, brain):
        assert [call.link for call in peer.got(CloseLink)] == [old]
        assert [call.route.link for call in peer.got(AddRoute)] == [old, new]
    (connection,) = desk.state.connections
    assert connection.link == new


def test_report_of_the_other_end_is_ignored(desk: Desk) -> None:
    west, _ = desk.wired()
    (old,) = opened(west)
    lose(desk, "west", old)
    lose(desk, "ann/brain", old)
    assert len(opened(west)) == 2


def test_report_of_the_other_end_during_the_pause_is_ignored(desk: Desk) -> None:
    west, _ = desk.wired()
    lose(desk, "west", opened(west)[-1])
    broken = opened(west)[-1]
    lose(desk, "west", broken)
    lose(desk, "ann/brain", broken)
    assert len(opened(west)) == 2
    desk.turn(links.RETRY_FIRST)
    assert len(opened(west)) == 3
    desk.turn(60)
    assert len(opened(west)) == 3


def test_report_of_a_process_that_is_no_end_is_ignored(desk: Desk) -> None:
    west, _ = desk.wired()
    lose(desk, "m1", opened(west)[0])
    lose(desk, "west", "no such link")
    assert len(opened(west)) == 1


def test_link_whose_connection_was_removed_during_the_pause_stays_closed(desk: Desk) -> None:
    west, _ = desk.wired()
    lose(desk, "west", opened(west)[-1])
    lose(desk, "west", opened(west)[-1])
    desk.do(m.Disconnect("r1/pose", "brain/pose"))
    desk.turn(60)
    assert (len(opened(west)), len(desk.state.links)) == (2, 0)


def test_link_that_keeps_breaking_is_reopened_with_growing_pauses(desk: Desk) -> None:
    west, brain = desk.wired()
    for _ in range(600):
        desk.turn(0.1)
        lose(desk, "west", opened(west)[-1])
    count = len(opened(west))
    assert 60 / links.RETRY_MOST < count < 60 / links.RETRY_MOST + 10
    desk.turn(60)
    lose(desk, "west", opened(west)[-1])
    assert len(opened(brain)) == len(opened(west)) == count + 2  # at once, because it had held for a while
