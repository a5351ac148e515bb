"""`…/recorders`: recorders of topics in environments."""

from __future__ import annotations

import msgspec

from master.api.commands import Commands, created
from master.api.environments import AT, ContentQuery
from master.api.principals import find_environment, page_of_records
from master.api.request import Answer, Call, OwnerQuery
from master.api.router import Api, Route
from master.graph.records import user_of
from master.service import Master
from rce.api.views import NewRecorder, Page, RecorderView
from rce.errors import NotFound
from rce.protocol import messages as m
from rce.spelling import tags, unknown


class RecordersApi:
    """Routes of recorders."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state
        self._commands = Commands(master)

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        recorders, recorder = AT + "/recorders", AT + "/recorders/{recorder}"
        started = "Record topics of an environment on its machine; the answer comes when it records"
        api.add(
            Route("GET", recorders, self._list, "Its recorders", ContentQuery, answer=Page[RecorderView]),
            Route("POST", recorders, self._add, started, OwnerQuery, NewRecorder, RecorderView, 201),
            Route("GET", recorder, self._show, "A recorder", OwnerQuery, answer=RecorderView),
            Route(
                "DELETE",
                recorder,
                self._remove,
                "End a recorder; the answer comes when its recording is complete",
                OwnerQuery,
                status=204,
            ),
        )

    async def _list(self, call: Call) -> Answer:
        query = call.query(ContentQuery)
        environment = find_environment(call, self._state, "recorder.read", query.user)
        records = self._state.recorders.by(environment.name)
        return page_of_records(records, user_of(environment.name), query, self._master.presenter.recorder)

    async def _add(self, call: Call) -> Answer:
        tag, wanted = call.path["environment"], call.body(NewRecorder)
        command = m.AddRecorder(tag, **msgspec.structs.asdict(wanted))
        owner = await self._commands.execute(call, call.query(OwnerQuery).user, command)
        view = self._view(owner, tag, wanted.recorderTag)
        return created(call, owner, view, "environments", tag, "recorders", wanted.recorderTag)

    async def _show(self, call: Call) -> Answer:
        environment = find_environment(call, self._state, "recorder.read", call.query(OwnerQuery).user)
        return Answer(self._view(user_of(environment.name), call.path["environment"], call.path["recorder"]))

    async def _remove(self, call: Call) -> Answer:
        command = m.RemoveRecorder(call.path["environment"], call.path["recorder"])
        await self._commands.execute(call, call.query(OwnerQuery).user, command)
        return Answer(status=204)

    def _view(self, owner: str, environment: str, tag: str) -> RecorderView:
        recorder = self._state.recorders.get(f"{owner}/{environment}/{tag}")
        if recorder is None:
            known = tags(each.key for each in self._state.recorders.by(f"{owner}/{environment}"))
            raise NotFound(f"in {environment} {unknown('recorder', tag, known)}", field="recorder")
        return self._master.presenter.recorder(recorder)
