"""Requests of environments, which come from the Master; it has authenticated and authorized them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path

from twisted.logger import Logger

from rce.api.knowledge import Entry
from rce.api.knowledge_requests import (
    MAX_FOUND,
    PIECE,
    AddEntry,
    ChangeEntry,
    FindEntries,
    Found,
    KnowledgeAnswer,
    PutPiece,
    ReadContent,
    RemoveEntry,
    RemoveFile,
    RunQuery,
    WaitForChanges,
)
from rce.control.calls.knowledge import AnswerKnowledge
from rce.errors import InvalidRequest, LimitExceeded, NotFound, TimedOut
from rce.knowledge.changes import Subscription
from rce.knowledge.queries import Queries
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from rce.knowledge.search import Search
from rce.knowledge.serql import translate

MOST_UPLOADS = 4  # of one environment at a time
PATIENCE = 60.0  # seconds between two pieces of an upload

log = Logger()


class Environments:
    """Answers requests of environments."""

    def __init__(self, repository: Repository, queries: Queries) -> None:
        self._repository = repository
        self._queries = queries
        self._uploads: dict[tuple[str, str], Upload] = {}  # by environment and name

    async def answer(self, call: AnswerKnowledge) -> KnowledgeAnswer:
        """Answer a request with the rights of the owner of the environment, though never those of an administrator."""
        reader = Reader(call.environment.partition("/")[0])
        repository = self._repository
        match call.request:
            case FindEntries() as wanted:
                return KnowledgeAnswer(await self._find(reader, wanted))
            case ReadContent() as wanted:
                return await self._read(reader, wanted)
            case RunQuery(query):
                return KnowledgeAnswer(result=await self._queries.run(reader, translate(query)))
            case WaitForChanges() as wanted:
                return await self._changes(reader, wanted)
            case AddEntry(new):
                return KnowledgeAnswer([_found(await repository.add(reader.user, new))])
            case ChangeEntry(kind, uid, change):
                return KnowledgeAnswer([_found(await repository.change(reader, kind, uid.lower(), change))])
            case RemoveEntry(kind, uid):
                await repository.remove(reader, kind, uid.lower())
            case RemoveFile(kind, uid, file):
                return KnowledgeAnswer([_found(await repository.remove_file(reader, kind, uid.lower(), file))])
            case PutPiece() as piece:
                await self._put(call.environment, reader, piece)
        return KnowledgeAnswer()

    async def stop(self) -> None:
        """Give up all uploads."""
        uploads = list(self._uploads.values())
        for upload in uploads:
            upload.storing.cancel()
        await asyncio.gather(*(upload.storing for upload in uploads), return_exceptions=True)

    async def _find(self, reader: Reader, wanted: FindEntries) -> list[Found]:
        if not wanted.exact:
            search = Search(kind=wanted.kind, prefix=wanted.prefix, limit=MAX_FOUND)
            return [_found(entry) for entry in (await self._repository.search(reader, search)).items]
        try:
            return [_found(await self._repository.entry(reader, wanted.kind, wanted.prefix.lower()))]
        except NotFound:
            return []

    async def _read(self, reader: Reader, wanted: ReadContent) -> KnowledgeAnswer:
        name = wanted.kind, wanted.uid.lower()
        if not wanted.file:
            text = (await self._repository.text(reader, *name, wanted.version)).text.encode()
            return KnowledgeAnswer(data=text[wanted.offset : wanted.offset + PIECE], size=len(text))
        path = await self._repository.file(reader, *name, wanted.file, wanted.version)
        return await asyncio.to_thread(_read_piece, path, wanted.offset)

    async def _changes(self, reader: Reader, wanted: WaitForChanges) -> KnowledgeAnswer:
        """Return changes; wait for the first one if there is none."""
        found, after = await self._repository.changes(reader, Subscription(), wanted.after)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(wanted.seconds):
                while wanted.after is not None and not found:
                    changed = self._repository.next_change()
                    found, after = await self._repository.changes(reader, Subscription(), after)
                    if not found:
                        await changed.wait()
        return KnowledgeAnswer(changes=found, newest=after)

    async def _put(self, environment: str, reader: Reader, piece: PutPiece) -> None:
        """Pass a piece on to its upload, which begins with the first one; the last one waits for its end."""
        key = environment, piece.upload
        upload = self._uploads.get(key)
        if upload is None and piece.offset == 0:
            if sum(other == environment for other, _ in self._uploads) >= MOST_UPLOADS:
                raise LimitExceeded(f"environment {environment} has {MOST_UPLOADS} uploads under way")
            upload = self._uploads[key] = Upload(self._repository, reader, piece)
            upload.storing.add_done_callback(partial(self._end, key))
        if upload is None or upload.received != piece.offset:
            raise InvalidRequest("this is not the next piece of the upload: send the file again", field="offset")
        await upload.add(piece)

    def _end(self, key: tuple[str, str], storing: asyncio.Task[Entry]) -> None:
        del self._uploads[key]
        if not storing.cancelled() and storing.exception() is not None:
            log.info("upload of {key} failed: {error}", key=key[0], error=str(storing.exception()))


class Upload:
    """File that arrives in pieces.

    Attributes:
        received: Number of bytes so far.
        storing: Adds the file to the entry when it is complete.
    """

    def __init__(self, repository: Repository, reader: Reader, first: PutPiece) -> None:
        """Begin to store a file."""
        self.received = 0
        self._pieces: asyncio.Queue[bytes | None] = asyncio.Queue(1)  # None is the end
        name = first.kind, first.uid.lower(), first.file
        self.storing = asyncio.create_task(repository.put_file(reader, *name, self._arriving()))

    async def add(self, piece: PutPiece) -> None:
        """Add a piece; raise the error with which the file is refused."""
        self.received += len(piece.data)
        await self._pass_on(piece.data)
        if piece.last:
            await self._pass_on(None)
            await asyncio.shield(self.storing)

    async def _pass_on(self, data: bytes | None) -> None:
        """Return when a piece was taken; raise the error with which the file is refused."""
        await self._pieces.put(data)
        taken = asyncio.ensure_future(self._pieces.join())
        try:
            await asyncio.wait([taken, self.storing], return_when=asyncio.FIRST_COMPLETED)
            if self.storing.done():
                self.storing.result()
        finally:
            taken.cancel()

    async def _arriving(self) -> AsyncIterator[bytes]:
        while True:
            try:
                async with asyncio.timeout(PATIENCE):
                    piece = await self._pieces.get()
            except TimeoutError:
                raise TimedOut(f"no piece of the file came for {PATIENCE:g} s: send it again") from None
            self._pieces.task_done()
            if piece is None:
                return
            yield piece


def _found(entry: Entry) -> Found:
    return Found(entry.uid, entry.version, [file.name for file in entry.files])


def _read_piece(path: Path, offset: int) -> KnowledgeAnswer:
    with path.open("rb") as file:
        file.seek(offset)
        return KnowledgeAnswer(data=file.read(PIECE), size=path.stat().st_size)
