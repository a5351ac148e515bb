"""The Master's calls about recordings, answered from the store of this machine."""

from __future__ import annotations

import asyncio

from containers.recordings.store import RecordingStore
from rce.control.calls.call import Nothing
from rce.control.calls.recordings import (
    AnnounceRecording,
    AppendRecording,
    ListRecordings,
    Piece,
    ReadRecording,
    RecordingInfo,
    Recordings,
    RemoveRecording,
)
from rce.control.connection import Handlers
from rce.control.removed_users import RemovedUsers


class RecordingCalls:
    """Answers calls. What reads or writes the disk runs in threads."""

    def __init__(self, store: RecordingStore) -> None:
        self._store = store
        file = store.directory.with_name(f"{store.directory.name}.removed-users")  # all within are recordings
        self._removed = RemovedUsers(file, self._forget)

    def add_to(self, handlers: Handlers) -> None:
        """Answer the calls with these handlers."""
        handlers.on(ListRecordings, self._list)
        handlers.on(ReadRecording, self._read)
        handlers.on(RemoveRecording, self._remove)
        handlers.on(AnnounceRecording, self._announce)
        handlers.on(AppendRecording, self._append)
        self._removed.add_to(handlers)

    async def _forget(self, user: str) -> None:
        await asyncio.to_thread(self._store.forget, user)

    async def _list(self, call: ListRecordings) -> Recordings:
        return Recordings(self._store.of(call.user))

    async def _read(self, call: ReadRecording) -> Piece:
        data = await asyncio.to_thread(self._store.read, call.user, call.recording, call.offset, call.length)
        return Piece(data)

    async def _remove(self, call: RemoveRecording) -> Nothing:
        await asyncio.to_thread(self._store.remove, call.user, call.recording)
        return Nothing()

    async def _announce(self, call: AnnounceRecording) -> RecordingInfo:
        return self._store.announce(call.user, call.name, call.length, call.fingerprint, call.quota)

    async def _append(self, call: AppendRecording) -> RecordingInfo:
        return await asyncio.to_thread(self._store.append, call.user, call.recording, call.offset, call.data)
