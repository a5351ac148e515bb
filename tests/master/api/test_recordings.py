"""Recordings over HTTP: lists over machines, downloads, uploads by tus, removal."""

from __future__ import annotations

import asyncio
import base64
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from containers.recordings.store import MAGIC, RecordingStore
from rce.api.http import basic
from rce.control.calls.recordings import PIECE, RecordingInfo
from rce.errors import Unavailable
from tests.support.master.recordings import keep_recordings, recorded
from tests.support.master.served import PASSWORD, Served

CONTENT = MAGIC + bytes(range(256)) * 3000 + MAGIC  # three pieces


@pytest.fixture
def store(served: Served, tmp_path: Path) -> RecordingStore:
    return keep_recordings(served, "m1", tmp_path / "m1")


async def ask(
    served: Served, method: str, path: str, body: bytes | None = None, **headers: str
) -> tuple[int, Any, Any]:
    """Return status, body and headers of a request of ann."""
    async with (
        aiohttp.ClientSession(served.url, headers=basic("ann", PASSWORD)) as session,
        session.request(method, f"/api/v1{path}", data=body, headers=headers) as answer,
    ):
        return answer.status, await answer.read(), answer.headers


def announcement(name: str = "drive.mcap", length: int = len(CONTENT)) -> dict[str, str]:
    metadata = f"filename {base64.b64encode(name.encode()).decode()},fingerprint {base64.b64encode(b'mark').decode()}"
    return {"Upload-Length": str(length), "Upload-Metadata": metadata, "Tus-Resumable": "1.0.0"}


CHUNK = {"Content-Type": "application/offset+octet-stream", "Tus-Resumable": "1.0.0"}


async def test_recordings_of_all_machines_are_listed_and_missing_ones_named(
    served: Served, store: RecordingStore, tmp_path: Path
) -> None:
    for name in ("m2", "m3", "m4"):
        await served.process("container", name, capacity=1)
    other = keep_recordings(served, "m2", tmp_path / "m2")
    served.peers["m3"].refuse |= dict.fromkeys(served.peers["m2"].answers, Unavailable("busy"))
    await served.leave("m4")
    ids = {recorded(store, CONTENT), recorded(other, CONTENT, "ann/attic")}
    recorded(store, CONTENT, "bob/brain")
    found = (await served.ask("GET", "/recordings")).body
    assert {each["recording"] for each in found["items"]} == ids
    assert {each["machine"] for each in found["items"]} == {"m1", "m2"}
    assert found["missing"] == ["m3", "m4"]
    one = (await served.ask("GET", "/recordings?environment=attic")).body["items"]
    assert [(each["containerTag"], each["recorderTag"], each["state"]) for each in one] == [
        ("attic", "box", "complete")
    ]
    assert len((await served.ask("GET", "/recordings?limit=1")).body["items"]) == 1


@pytest.mark.parametrize(
    ("wanted", "status", "expected"),
    [
        ("", 200, CONTENT),
        ("bytes=5-9", 206, CONTENT[5:10]),
        (f"bytes={PIECE - 1}-{PIECE}", 206, CONTENT[PIECE - 1 : PIECE + 1]),
        ("bytes=-8", 206, MAGIC),
        (f"bytes={len(CONTENT)}-", 416, b""),
    ],
)
async def test_recording_is_downloaded_whole_or_in_part(
    served: Served, store: RecordingStore, wanted: str, status: int, expected: bytes
) -> None:
    id = recorded(store, CONTENT)
    headers = {"Range": wanted} if wanted else {}
    found, body, answer = await ask(served, "GET", f"/recordings/m1/{id}/file", **headers)
    assert (found, body) == (status, expected)
    assert answer["Accept-Ranges"] == "bytes"


async def test_recording_is_removed_by_its_owner(served: Served, store: RecordingStore) -> None:
    id = recorded(store, CONTENT)
    assert (await served.ask("DELETE", f"/recordings/m1/{id}", "bob")).status == 404
    assert (await served.ask("DELETE", f"/recordings/m1/{id}", "vera")).status == 403
    assert (await served.ask("DELETE", f"/recordings/m1/{id}")).status == 204
    assert (await served.ask("GET", f"/recordings/m1/{id}")).status == 404
    assert (await served.ask("GET", f"/recordings/west/{id}")).status == 404
    audit = (await served.ask("GET", "/audit?action=recording.remove&result=ok")).body["items"]
    assert {each["result"] for each in audit} == {"ok"}


async def test_recording_is_uploaded_in_parts(served: Served, store: RecordingStore) -> None:
    status, _, headers = await ask(served, "POST", "/recordings", **announcement())
    assert status == 201
    place = headers["Location"].removeprefix("/api/v1")
    half = len(CONTENT) // 2
    assert (await ask(served, "PATCH", place, CONTENT[:half], **CHUNK, **{"Upload-Offset": "0"}))[0] == 204
    status, _, headers = await ask(served, "HEAD", place)
    assert (status, headers["Upload-Offset"], headers["Upload-Length"]) == (200, str(half), str(len(CONTENT)))
    assert (await ask(served, "PATCH", place, CONTENT[half:], **CHUNK, **{"Upload-Offset": "0"}))[0] == 409
    assert (await ask(served, "PATCH", place, CONTENT[half:], **CHUNK, **{"Upload-Offset": str(half)}))[0] == 204
    assert (await ask(served, "GET", f"{place}/file"))[1] == CONTENT
    (found,) = (await served.ask("GET", "/recordings")).body["items"]
    assert (found["name"], found["state"], found["fingerprint"]) == ("drive.mcap", "complete", "mark")


async def test_upload_that_is_not_possible_is_refused(served: Served, store: RecordingStore) -> None:
    await served.master.limits.change("ann", {"recording_bytes": 1000})
    assert (await ask(served, "POST", "/recordings", **announcement()))[0] == 413
    assert (await ask(served, "POST", "/recordings", **announcement("a.bag", 10)))[0] == 400
    assert (await ask(served, "POST", "/recordings"))[0] == 400
    wrong = announcement() | {"Tus-Resumable": "0.1"}
    assert (await ask(served, "POST", "/recordings", **wrong))[0] == 412
    assert (await ask(served, "PATCH", "/recordings/m1/none", b"x", **CHUNK, **{"Upload-Offset": "0"}))[0] == 404
    assert (await ask(served, "PATCH", "/recordings/m1/none", b"x", **{"Upload-Offset": "0"}))[0] == 415
    assert (await ask(served, "POST", "/recordings?machine=m9", **announcement(length=10)))[0] == 404


async def test_upload_goes_to_the_first_machine_with_room(
    served: Served, store: RecordingStore, tmp_path: Path
) -> None:
    await served.process("container", "m0", capacity=1)
    full = keep_recordings(served, "m0", tmp_path / "m0")
    full._spare = 10**18
    _, _, headers = await ask(served, "POST", "/recordings", **announcement())
    assert headers["Location"].startswith("/api/v1/recordings/m1/")


async def test_upload_ends_when_its_credentials_are_revoked(
    served: Served, store: RecordingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, begun, append = asyncio.get_running_loop(), asyncio.Event(), store.append

    def note_and_append(user: str, id: str, offset: int, data: bytes) -> RecordingInfo:
        loop.call_soon_threadsafe(begun.set)
        return append(user, id, offset, data)

    monkeypatch.setattr(store, "append", note_and_append)
    _, _, headers = await ask(served, "POST", "/recordings", **announcement())
    place, begin = headers["Location"], 2 * PIECE

    async def body() -> AsyncIterator[bytes]:
        yield CONTENT[:begin]
        await begun.wait()
        await served.master.guard.change_password("ann", "another long password")
        yield CONTENT[begin:]

    async with (
        aiohttp.ClientSession(served.url, headers=basic("ann", PASSWORD)) as session,
        session.patch(place, data=body(), headers={**CHUNK, "Upload-Offset": "0"}) as answer,
    ):
        assert answer.status == 401
    assert store.of("ann")[0].state == "uploading"


async def test_key_of_an_announcement_is_for_one_file(served: Served, store: RecordingStore) -> None:
    key = {"Idempotency-Key": "k"}
    assert [(await ask(served, "POST", "/recordings", **announcement(), **key))[0] for _ in range(2)] == [201, 201]
    assert len(store.of("ann")) == 1
    assert (await ask(served, "POST", "/recordings", **announcement(length=10), **key))[0] == 409
    assert (await ask(served, "POST", "/recordings", **announcement("other.mcap"), **key))[0] == 409


async def test_download_breaks_off_when_its_credentials_are_revoked(
    served: Served, store: RecordingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    id, revoked, read = recorded(store, CONTENT), threading.Event(), store.read

    def wait_and_read(user: str, id: str, offset: int, length: int) -> bytes:
        if offset:
            revoked.wait(10)
        return read(user, id, offset, length)

    monkeypatch.setattr(store, "read", wait_and_read)
    async with (
        aiohttp.ClientSession(served.url, headers=basic("ann", PASSWORD)) as session,
        session.get(f"/api/v1/recordings/m1/{id}/file") as answer,
    ):
        await answer.content.readexactly(PIECE)
        await served.master.guard.change_password("ann", "another long password")
        revoked.set()
        with pytest.raises(aiohttp.ClientPayloadError):
            await answer.read()
