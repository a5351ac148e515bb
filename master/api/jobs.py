"""`/api/v1/jobs`: jobs are the map service's, whose list this leads to."""

from __future__ import annotations

from master.api.acting import acting
from master.api.calls import Answer, Call
from master.api.router import Api, Route
from master.service import Master
from rce.errors import NotFound
from rce.map_jobs import PREFIX

SERVICE = PREFIX.strip("/")  # the name by which it has joined


class JobsApi:
    """One redirect."""

    def __init__(self, master: Master) -> None:
        self._state = master.state

    def add_to(self, api: Api) -> None:
        api.add(Route("GET", "/jobs", self.lead, "Where the jobs of the map service are listed", status=307))

    async def lead(self, call: Call) -> Answer:
        acting(call, "job.read", "")
        if SERVICE not in self._state.processes:
            raise NotFound("no map service has joined this platform")
        return Answer(status=307, headers={"location": f"{PREFIX}/jobs"})
