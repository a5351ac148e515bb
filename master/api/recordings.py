"""`/api/v1/recordings`: recordings, which task sets keep on their machines.

Their bytes pass the Master in pieces, over the control connections of the task sets. Uploads follow tus 1.0.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Annotated, TypeVar

from aiohttp import web
from msgspec import Meta

from master.api.downloads import Download
from master.api.principals import authorize, page_of_views
from master.api.request import Answer, Call, Owner, OwnerQuery, PageQuery
from master.api.router import PREFIX, Api, Route
from master.service import Master
from rce.api.views import Page, RecordingPage, RecordingView
from rce.control.calls.call import Call as ControlCall
from rce.control.calls.recordings import (
    PIECE,
    AnnounceRecording,
    AppendRecording,
    ListRecordings,
    ReadRecording,
    RecordingInfo,
    RemoveRecording,
)
from rce.errors import LimitExceeded, NotFound, RceError, TimedOut, Unauthorized, Unavailable
from rce.web import tus
from rce.web.requests import accept_body, body_pieces

AT = "/recordings/{machine}/{recording}"
PIECE_TIMEOUT = 60.0  # seconds for a piece: the disk of the machine may be slow
TRANSFERS = 4  # of one user at once
R = TypeVar("R")


class RecordingsQuery(PageQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of recordings."""

    user: Owner = ""
    environment: Annotated[str, Meta(description="of this environment; empty: all, and uploads")] = ""


class UploadQuery(OwnerQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a new upload."""

    machine: Annotated[str, Meta(description="machine that keeps it; empty: the first with room")] = ""


class RecordingsApi:
    """Routes of recordings."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state
        self._transfers: Counter[str] = Counter()

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        announce = "Announce an upload by the headers Upload-Length and Upload-Metadata (`filename`) of tus 1.0"
        append = "Append to an upload at Upload-Offset, by tus 1.0"
        api.add(
            Route("GET", "/recordings", self._list, "Recordings", RecordingsQuery, answer=RecordingPage),
            Route("POST", "/recordings", self._announce, announce, UploadQuery, answer=RecordingView, status=201),
            Route("GET", AT, self._show, "A recording", OwnerQuery, answer=RecordingView),
            Route("PATCH", AT, self._append, append, OwnerQuery, status=204, streamed=True),
            Route("DELETE", AT, self._remove, "Remove a recording", OwnerQuery, status=204),
            Route("GET", AT + "/file", self._download, "Its file, or a Range of it", OwnerQuery, answer=bytes),
        )

    async def _list(self, call: Call) -> Answer:
        query = call.query(RecordingsQuery)
        user = authorize(call, "recording.read", query.user)
        machines = sorted(each.name for each in self._state.processes.by("container"))
        answers = await asyncio.gather(*(self._of(machine, user) for machine in machines))
        views = [view for found in answers for view in found or ()]
        missing = [machine for machine, found in zip(machines, answers, strict=True) if found is None]
        kept = ((f"{view.machine}/{view.recording}", view) for view in views)
        page = page_of_views(kept, query, lambda view: query.environment in ("", view.containerTag)).body
        assert isinstance(page, Page)
        return Answer(RecordingPage(page.items, page.next, missing))

    async def _of(self, machine: str, user: str) -> list[RecordingView] | None:
        """Return a user's recordings on a machine; None if it does not answer."""
        try:
            found = await self._master.ask_machine(machine, ListRecordings(user))
        except RceError:
            return None
        return [_view(user, machine, each) for each in found.recordings]

    async def _show(self, call: Call) -> Answer:
        user = authorize(call, "recording.read", call.query(OwnerQuery).user)
        return _upload_answer(await self._find(call, user))

    async def _remove(self, call: Call) -> Answer:
        user = authorize(call, "recording.remove", call.query(OwnerQuery).user)
        await self._ask(call.path["machine"], RemoveRecording(user, call.path["recording"]))
        return Answer(status=204)

    async def _download(self, call: Call) -> Answer:
        user = authorize(call, "recording.read", call.query(OwnerQuery).user)
        view = await self._find(call, user)

        revoked: list[str] = []

        async def read(offset: int, length: int) -> bytes:
            _check_credentials(revoked)
            piece = ReadRecording(user, view.recording, offset, min(length, PIECE))
            return (await self._ask(view.machine, piece, PIECE_TIMEOUT)).data

        return Answer(Download(view.name, view.size, read, lambda: self._transfer(call, user, revoked)))

    @contextmanager
    def _transfer(self, call: Call, user: str, revoked: list[str]) -> Iterator[None]:
        """Count a transfer of a user's recording while it lasts; raise LimitExceeded if there are too many.

        When the credentials of the call are revoked meanwhile, `revoked` gets the reason.
        """
        if self._transfers[user] >= TRANSFERS:
            raise LimitExceeded(f"{user} has {TRANSFERS} transfers under way: wait for one to end", limit=TRANSFERS)
        self._transfers[user] += 1
        assert call.principal is not None  # the routes are not public
        release = self._master.guard.hold(call.principal, revoked.append)
        try:
            yield
        finally:
            release()
            self._transfers[user] -= 1

    # --- uploads ------------------------------------------------------------------------------------------------------

    async def _announce(self, call: Call) -> Answer:
        query = call.query(UploadQuery)
        user = authorize(call, "recording.upload", query.user)
        tus.check_version(call.request.headers)
        length = tus.number(call.request.headers.get("Upload-Length"), "Upload-Length")
        metadata = tus.metadata(call.request.headers.get("Upload-Metadata", ""))
        quota = self._master.recording_quota(user)
        name, mark = metadata.get("filename", ""), metadata.get("fingerprint", "")
        wanted = AnnounceRecording(user, name, length, mark, quota)
        view = await self._place(user, query.machine, wanted)
        call.audit.names = [view.machine, view.recording]
        place = f"{PREFIX}/recordings/{view.machine}/{view.recording}"
        return _upload_answer(view, 201, {"Location": place if user == call.user else f"{place}?user={user}"})

    async def _place(self, user: str, machine: str, wanted: AnnounceRecording) -> RecordingView:
        """Make room for an upload on the first machine that has it."""
        joined = sorted(each.name for each in self._state.processes.by("container") if each.name in self._state.joined)
        refusal: RceError = Unavailable("no machine is connected at present that could keep a recording")
        for name in [machine] if machine else joined:
            try:
                return _view(user, name, await self._ask(name, wanted))
            except (LimitExceeded, Unavailable, TimedOut) as error:
                refusal = error
        raise refusal

    async def _append(self, call: Call) -> Answer:
        user = authorize(call, "recording.upload", call.query(OwnerQuery).user)
        tus.check_version(call.request.headers)
        tus.check_chunk(call.request.content_type)
        offset = tus.number(call.request.headers.get("Upload-Offset"), "Upload-Offset")
        view = await self._find(call, user)
        revoked: list[str] = []
        with self._transfer(call, user, revoked):
            await accept_body(call.request)
            async for data in _pieces(call.request):
                _check_credentials(revoked)
                change = AppendRecording(user, view.recording, offset, data)
                view = _view(user, view.machine, await self._ask(view.machine, change, PIECE_TIMEOUT))
                offset = view.size
        return _upload_answer(view, 204)

    # ------------------------------------------------------------------------------------------------------------------

    async def _find(self, call: Call, user: str) -> RecordingView:
        machine, id = call.path["machine"], call.path["recording"]
        found = await self._ask(machine, ListRecordings(user))
        for each in found.recordings:
            if each.id == id:
                return _view(user, machine, each)
        raise NotFound(f"there is no recording {id[:64]!r} on {machine[:80]}", field="recording")

    async def _ask(self, machine: str, question: ControlCall[R], seconds: float = PIECE_TIMEOUT) -> R:
        process = self._state.processes.get(machine)
        if process is None or process.role != "container":
            raise NotFound(f"there is no machine {machine[:80]!r}", field="machine")
        return await self._master.ask_machine(machine, question, seconds)


async def _pieces(request: web.BaseRequest) -> AsyncIterator[bytes]:
    """Yield the body in pieces for the task set; what came before the client disconnected, too.

    Raises:
        TimedOut: It comes too slowly.
    """
    kept = bytearray()
    try:
        async for data in body_pieces(request):
            kept += data
            while len(kept) >= PIECE:
                yield bytes(kept[:PIECE])
                del kept[:PIECE]
    except web.HTTPRequestTimeout:
        raise TimedOut("the data came too slowly: continue at the offset that HEAD returns") from None
    except ConnectionError:
        pass  # what was received is kept
    if kept:
        yield bytes(kept)


def _check_credentials(revoked: list[str]) -> None:
    if revoked:
        raise Unauthorized(f"the transfer ends: {revoked[0]}")


def _view(user: str, machine: str, info: RecordingInfo) -> RecordingView:
    return RecordingView(
        *(user, machine, info.id, info.name, info.state, info.size, info.created),
        *(info.environment, info.recorder, info.length, info.fingerprint),
    )


def _upload_answer(view: RecordingView, status: int = 200, headers: dict[str, str] | None = None) -> Answer:
    """Return a recording as JSON, and the headers of tus for one that was uploaded."""
    given = {"Upload-Offset": str(view.size), "Upload-Length": str(view.length), "Cache-Control": "no-store"}
    found = tus.answer_headers(given) if view.length else {}
    body = view if status != 204 else None
    return Answer(body, status, found | (headers or {}))
