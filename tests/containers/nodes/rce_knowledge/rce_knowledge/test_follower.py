"""The follower of changes."""

from __future__ import annotations

import queue
from pathlib import Path

import pytest

from rce.api.knowledge import Change
from rce.api.knowledge_requests import AddEntry, KnowledgeAnswer, KnowledgeRequest
from rce.errors import Unavailable
from tests.support.environment_knowledge import direct_knowledge
from tests.support.knowledge import new_entry

LIMIT = 60.0  # seconds


def test_changes_are_published_from_the_first_listener_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rce_knowledge import follower as module

    monkeypatch.setattr(module, "PAUSE", 0.01)
    found: queue.Queue[Change] = queue.Queue()
    listening: queue.Queue[int] = queue.Queue()
    with direct_knowledge(tmp_path) as knowledge:
        asked: queue.Queue[KnowledgeRequest] = queue.Queue()
        ask = knowledge.ask

        def counted(request: KnowledgeRequest) -> KnowledgeAnswer:
            asked.put(request)
            if asked.qsize() == 1 and not listening.empty():
                raise Unavailable("away")
            return ask(request)

        monkeypatch.setattr(knowledge, "ask", counted)
        follower = module.Follower(knowledge, listening.qsize, found.put)
        ask(AddEntry(new_entry(id="before")))
        listening.put(1)
        while asked.qsize() < 3:  # a failure, the newest number, and the first wait
            follower._stopped.wait(0.01)
        ask(AddEntry(new_entry(id="after")))
        assert found.get(timeout=LIMIT).uid == "cup.after"
        follower.stop()
        ask(AddEntry(new_entry(id="late")))
        follower._thread.join(LIMIT)
        assert not follower._thread.is_alive()
        assert found.empty()
