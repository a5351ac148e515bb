"""`/api/v1/jobs`: a redirect to the jobs of the map service."""

from __future__ import annotations

from master.api.principals import authorize
from master.api.request import Answer, Call
from master.api.router import Api, Route
from master.service import Master
from rce.api.map_jobs import PREFIX
from rce.errors import NotFound

SERVICE = PREFIX.strip("/")  # name by which it joins


class JobsApi:
    """Route of jobs."""

    def __init__(self, master: Master) -> None:
        self._state = master.state

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(Route("GET", "/jobs", self._redirect, "Redirect to the jobs of the map service", status=307))

    async def _redirect(self, call: Call) -> Answer:
        authorize(call, "job.read", "")
        if SERVICE not in self._state.processes:
            raise NotFound("no map service has joined this platform")
        return Answer(status=307, headers={"location": f"{PREFIX}/jobs"})
