"""Requests of environments, answered by the repository."""

from __future__ import annotations

import asyncio

import pytest

from rce.api.knowledge import EntryChange, NewEntry
from rce.api.knowledge_requests import (
    PIECE,
    AddEntry,
    ChangeEntry,
    FindEntries,
    Found,
    KnowledgeAnswer,
    KnowledgeRequest,
    PutPiece,
    ReadContent,
    RemoveEntry,
    RemoveFile,
    RunQuery,
    WaitForChanges,
)
from rce.control.calls.knowledge import AnswerKnowledge
from rce.errors import Forbidden, InvalidRequest, LimitExceeded, NotFound, TimedOut
from rce.knowledge import environments
from tests.support.knowledge import CUP, Service, new_entry

ANN, BOB = "ann/brain", "bob/brain"
UPLOAD = "u" * 16
QUERY = """SELECT source FROM CONTEXT source {S} k:height {H}
USING NAMESPACE k = <http://example.org/kitchen.owl#>"""


async def ask(service: Service, request: KnowledgeRequest, environment: str = ANN) -> KnowledgeAnswer:
    return await service.service.environments.answer(AnswerKnowledge(environment, request))


def piece(offset: int, data: bytes, last: bool, upload: str = UPLOAD) -> PutPiece:
    return PutPiece("object", "cup.blue", "cup.stl", upload, offset, data, last)


async def test_entry_is_added_found_read_changed_and_removed(service: Service) -> None:
    await ask(service, AddEntry(new_entry(public=True)))
    assert (await ask(service, FindEntries("object", "cu"))).entries == [Found("cup.blue", 1)]
    assert (await ask(service, FindEntries("object", "cu", exact=True))).entries == []
    assert (await ask(service, FindEntries("object", "CUP.blue", exact=True), BOB)).entries == [Found("cup.blue", 1)]
    read = await ask(service, ReadContent("object", "cup.blue", 1))
    assert (read.data.decode(), read.size) == (CUP, len(CUP))
    found = await ask(service, RunQuery(QUERY))
    assert found.result is not None
    assert found.result.rows == [["<https://rce.invalid/knowledge/object/cup.blue>"]]
    await ask(service, ChangeEntry("object", "cup.blue", EntryChange(description="new")))
    assert (await ask(service, FindEntries("object", "cup"))).entries == [Found("cup.blue", 2)]
    with pytest.raises(Forbidden):
        await ask(service, RemoveEntry("object", "cup.blue"), BOB)
    await ask(service, RemoveEntry("object", "cup.blue"))
    assert (await ask(service, FindEntries("object", "cup"))).entries == []


async def test_owner_has_no_rights_of_an_administrator(service: Service) -> None:
    await ask(service, AddEntry(NewEntry("object", "cup", "secret")))
    assert (await ask(service, FindEntries("object", "cup"), "root/brain")).entries == []


async def test_file_travels_in_pieces(service: Service) -> None:
    await ask(service, AddEntry(new_entry()))
    content = bytes(range(256)) * (PIECE // 128) + b"end"
    for offset in range(0, len(content), PIECE):
        data = content[offset : offset + PIECE]
        await ask(service, piece(offset, data, offset + PIECE >= len(content)))
    assert (await ask(service, FindEntries("object", "cup"))).entries == [Found("cup.blue", 2, ["cup.stl"])]
    got = b""
    while len(got) < len(content):
        answer = await ask(service, ReadContent("object", "cup.blue", 2, "cup.stl", len(got)))
        assert answer.size == len(content)
        got += answer.data
    assert got == content
    await ask(service, RemoveFile("object", "cup.blue", "cup.stl"))
    assert (await ask(service, FindEntries("object", "cup"))).entries == [Found("cup.blue", 3)]
    with pytest.raises(NotFound):
        await ask(service, ReadContent("object", "cup.blue", 3, "cup.stl"))


async def test_refusal_of_a_file_is_the_answer_to_its_piece(service: Service) -> None:
    with pytest.raises(NotFound):
        await ask(service, piece(0, b"first", last=False))
    await ask(service, AddEntry(new_entry(public=True)))
    with pytest.raises(Forbidden):
        await ask(service, piece(0, b"first", last=True), BOB)
    with pytest.raises(InvalidRequest, match="not the next piece"):
        await ask(service, piece(5, b"second", last=True))
    await ask(service, piece(0, b"first", last=False))
    with pytest.raises(InvalidRequest, match="not the next piece"):
        await ask(service, piece(4, b"second", last=True))
    await ask(service, piece(5, b"", last=True))


async def test_uploads_of_an_environment_are_bounded_and_end_when_nothing_comes(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    await ask(service, AddEntry(new_entry()))
    for number in range(environments.MOST_UPLOADS):
        await ask(service, piece(0, b"first", last=False, upload=f"{number:016}"))
    with pytest.raises(LimitExceeded, match="uploads under way"):
        await ask(service, piece(0, b"first", last=False))
    uploads = service.service.environments._uploads
    stored = [upload.storing for upload in uploads.values()]
    await service.service.environments.stop()
    assert all(each.cancelled() for each in stored)
    await asyncio.sleep(0)
    assert not uploads
    monkeypatch.setattr(environments, "PATIENCE", 0.01)
    await ask(service, piece(0, b"first", last=False))
    (upload,) = uploads.values()
    with pytest.raises(TimedOut, match="send it again"):
        await upload.storing


async def test_changes_are_waited_for(service: Service) -> None:
    before = (await ask(service, WaitForChanges(), BOB)).newest
    waiting = asyncio.create_task(ask(service, WaitForChanges(before, 30), BOB))
    await ask(service, AddEntry(NewEntry("object", "cup", "secret")))
    await ask(service, AddEntry(new_entry(public=True)))
    answer = await waiting
    assert [(each.action, each.uid, each.user) for each in answer.changes] == [("added", "cup.blue", "ann")]
    assert answer.newest == before + 2
    assert (await ask(service, WaitForChanges(answer.newest, 0), BOB)).changes == []
