"""Recorders over HTTP, and what their environment is told."""

from __future__ import annotations

import asyncio

import pytest

from rce.api.views import Event
from rce.control.calls.endpoints import RecorderEnded, RecorderSpec, StartRecorder, StopRecorder
from rce.control.calls.recordings import BeginRecording
from rce.errors import LimitExceeded, NotFound
from tests.support.master.served import Served

PATH = "/environments/brain/recorders"


async def test_recorder_is_started_shown_and_removed(populated: Served) -> None:
    body = {"recorderTag": "box", "topics": ["scan"], "maxSize": 1000}
    made = await populated.ask("POST", PATH, body=body)
    assert made.status == 201
    assert made.headers["location"] == f"/api/v1{PATH}/box"
    assert (made.body["topics"], made.body["state"]) == (["/scan"], "recording")
    assert StartRecorder(RecorderSpec("box", ["/scan"], 1000)) in populated.peers["ann/brain"].calls
    assert (await populated.ask("GET", PATH)).body["items"] == [made.body]
    assert (await populated.ask("GET", "/environments/brain")).body["recorders"] == 1
    assert (await populated.ask("POST", PATH, body=body)).status == 409
    assert (await populated.ask("POST", PATH, body=body | {"existOk": True})).status == 201
    assert (await populated.ask("DELETE", f"{PATH}/box")).status == 204
    assert StopRecorder("box") in populated.peers["ann/brain"].calls
    assert (await populated.ask("GET", f"{PATH}/box")).status == 404
    assert (await populated.ask("DELETE", f"{PATH}/box")).status == 404


async def test_recorder_that_does_not_start_is_not_kept(populated: Served) -> None:
    populated.peers["ann/brain"].refuse[StartRecorder] = LimitExceeded("no room")
    assert (await populated.ask("POST", PATH, body={"recorderTag": "box"})).body["code"] == "limit_exceeded"
    assert (await populated.ask("GET", PATH)).body["items"] == []


async def test_recorder_that_ends_by_itself_is_gone_and_reported(populated: Served) -> None:
    events = populated.master.events.follow(populated.master.events.position(""))
    following = asyncio.ensure_future(_next(events, "recorder.ended"))
    await populated.ask("POST", PATH, body={"recorderTag": "box"})
    await populated.call_master("ann/brain", RecorderEnded("box", "quota"))
    event = await asyncio.wait_for(following, 20)
    assert (event.user, event.object, event.text) == ("ann", "ann/brain/box", "quota")
    assert (await populated.ask("GET", PATH)).body["items"] == []
    await populated.call_master("ann/brain", RecorderEnded("box", "again"))  # harmless


async def _next(events: object, kind: str) -> Event:
    async for event in events:  # type: ignore[attr-defined]
        if event.type == kind:
            return event  # type: ignore[no-any-return]
    raise AssertionError


async def test_machine_may_record_what_a_user_asked_for_alone(populated: Served) -> None:
    await populated.ask("POST", PATH, body={"recorderTag": "box"})
    assert (await populated.call_master("m1", BeginRecording("ann/brain", "box"))).bytes is None
    await populated.master.limits.change("ann", {"recording_bytes": 7})
    assert (await populated.call_master("m1", BeginRecording("ann/brain", "box"))).bytes == 7
    await populated.process("container", "m2", capacity=1)
    for machine, call in (
        ("m1", BeginRecording("ann/brain", "other")),
        ("m1", BeginRecording("ann/nothing", "box")),
        ("m2", BeginRecording("ann/brain", "box")),
    ):
        with pytest.raises(NotFound):
            await populated.call_master(machine, call)
