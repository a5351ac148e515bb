"""Environments use the knowledge service with the rights of their owner."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from master.access.audit import AuditFilter
from rce.api.knowledge import NewEntry
from rce.api.knowledge_requests import AddEntry, FindEntries, PutPiece
from rce.control.calls.knowledge import SERVICE, AnswerKnowledge, AskKnowledge, NotedChange, ReportChanges
from rce.errors import Forbidden, InvalidRequest, LimitExceeded, NotFound, Unavailable
from tests.support.master.peers import Furnished

FIND = AskKnowledge(FindEntries("object", "cup"))
ADD = AskKnowledge(AddEntry(NewEntry("object", "cup", "blue")))


def piece(last: bool) -> AskKnowledge:
    return AskKnowledge(PutPiece("object", "cup.blue", "cup.stl", "u" * 16, 0, b"x", last))


async def audited(furnished: Furnished) -> list[tuple[str, str, str, str, str]]:
    found = await furnished.platform.master.audit.find(AuditFilter(), None, 100)
    return [
        (each.user, each.action, each.object, each.result, each.origin)
        for each in found
        if each.action.startswith("knowledge.")
    ]


async def test_request_reaches_the_service_as_the_environment_and_changes_are_audited(furnished: Furnished) -> None:
    service = await furnished.platform.process("service", SERVICE)
    assert (await furnished.brain.call(FIND)).data == b"known"
    assert await service.next(AnswerKnowledge) == AnswerKnowledge("ann/brain", FIND.request)
    for call in (ADD, piece(False), piece(True)):
        await furnished.brain.call(call)
    assert await audited(furnished) == [
        ("ann", "knowledge.put_file", "ann/object/cup.blue/cup.stl", "ok", "environment brain"),
        ("ann", "knowledge.add", "ann/object/cup.blue", "ok", "environment brain"),
    ]


async def test_environment_of_who_may_only_read_does_not_write(furnished: Furnished) -> None:
    await furnished.platform.process("service", SERVICE)
    await furnished.platform.master.users.add("root", "secret", "admin")
    await furnished.platform.master.users.change_role("ann", "viewer")
    assert (await furnished.brain.call(FIND)).data == b"known"
    with pytest.raises(Forbidden, match=r"knowledge\.write"):
        await furnished.brain.call(ADD)
    assert [(action, result) for _, action, _, result, _ in await audited(furnished)] == [
        ("knowledge.add", "forbidden")
    ]


async def test_errors_of_the_service_come_back_and_its_absence_is_told(furnished: Furnished) -> None:
    with pytest.raises(Unavailable, match="away"):
        await furnished.brain.call(FIND)
    service = await furnished.platform.process("service", SERVICE)
    service.refuse[AnswerKnowledge] = NotFound("there is no object")
    with pytest.raises(NotFound, match="no object"):
        await furnished.brain.call(FIND)


async def test_requests_of_an_environment_are_bounded(furnished: Furnished) -> None:
    service = await furnished.platform.process("service", SERVICE)
    service.answering.clear()
    waiting = [asyncio.ensure_future(furnished.brain.call(FIND)) for _ in range(8)]
    for _ in waiting:
        await service.next(AnswerKnowledge)
    with pytest.raises(LimitExceeded, match="8 requests"):
        await furnished.brain.call(FIND)
    service.answering.set()
    await asyncio.gather(*waiting)
    await furnished.brain.call(FIND)


async def test_only_environments_ask(furnished: Furnished) -> None:
    others: list[Any] = [furnished.west, furnished.m1]
    for process in others:
        with pytest.raises(InvalidRequest, match="does not answer"):
            await process.call(FIND)


async def test_only_the_knowledge_service_reports_changes(furnished: Furnished) -> None:
    service = await furnished.platform.process("service", SERVICE)
    other = await furnished.platform.process("service", "map-service")
    report = ReportChanges([NotedChange("added", "object", "cup.blue", "ann", "ann", True)])
    await service.call(report)
    events = furnished.platform.master.events
    follower = events.follow(0)
    objects = []
    while "ann/object/cup.blue" not in objects:
        objects.append((await anext(follower)).object)
    for process in (other, furnished.brain):
        with pytest.raises(InvalidRequest, match="does not answer"):
            await process.call(report)
