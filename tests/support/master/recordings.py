"""Machines of a served Master that keep recordings in real stores."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from containers.recordings.calls import RecordingCalls
from containers.recordings.store import RecordingStore
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
from tests.support.master.served import Served

CALLS = (ListRecordings, ReadRecording, RemoveRecording, AnnounceRecording, AppendRecording)


def keep_recordings(served: Served, machine: str, directory: Path) -> RecordingStore:
    """Let a machine answer calls about recordings from a store in a directory."""
    store, handlers = RecordingStore(directory), Handlers()
    RecordingCalls(store).add_to(handlers)

    served.peers[machine].answers |= dict.fromkeys(CALLS, partial(answer, handlers))
    return store


def recorded(store: RecordingStore, content: bytes, environment: str = "ann/brain") -> str:
    """Add a recording of an environment; return its id."""
    recording = store.begin(environment, "box", RecordingQuota())
    recording.write(content)
    recording.end()
    return recording.id
