"""The Master's calls about recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from containers.recordings.calls import RecordingCalls
from containers.recordings.store import MAGIC, RecordingStore
from rce.control.calls.call import Call
from rce.control.calls.recordings import (
    AnnounceRecording,
    AppendRecording,
    ListRecordings,
    ReadRecording,
    RecordingQuota,
    RemoveRecording,
)
from rce.control.connection import Handlers
from tests.support.control import answer


async def test_calls_are_answered_from_the_store(tmp_path: Path) -> None:
    handlers = Handlers()
    RecordingCalls(RecordingStore(tmp_path)).add_to(handlers)

    async def ask(call: Call[Any]) -> Any:
        return await answer(handlers, call)

    content = MAGIC + bytes(10)
    made = await ask(AnnounceRecording("ann", "a.mcap", len(content), "", RecordingQuota()))
    assert (await ask(AppendRecording("ann", made.id, 0, content))).state == "complete"
    assert (await ask(ReadRecording("ann", made.id, 0, 8))).data == MAGIC
    assert [each.id for each in (await ask(ListRecordings("ann"))).recordings] == [made.id]
    await ask(RemoveRecording("ann", made.id))
    assert (await ask(ListRecordings("ann"))).recordings == []
