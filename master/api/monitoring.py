"""`/healthz`, `/readyz` and `/metrics`, beside the API: what supervisors and Prometheus ask for.

Only the Master needs to be reached by Prometheus: it hands on what other processes tell over their control connections.
"""

from __future__ import annotations

from urllib.parse import quote

from msgspec import Struct

from master.api.acting import platform
from master.api.calls import Answer, Call
from master.api.router import Api, Route
from master.service import Master
from rce import exposition, metrics
from rce.errors import NotFound

PATH = "/metrics"


class Health(Struct, frozen=True):
    """`missing` has a sentence for each thing that the platform lacks to do what it is for."""

    status: str
    missing: list[str] = []


class Target(Struct, frozen=True):
    """As Prometheus' HTTP service discovery wants it."""

    targets: list[str]
    labels: dict[str, str]


class Monitoring:
    """Beside the API, because that is where such things are looked for."""

    def __init__(self, master: Master) -> None:
        self._master = master

    def add_to(self, api: Api) -> None:
        api.add_beside(
            Route("GET", "/healthz", self.alive, for_all=True),
            Route("GET", "/readyz", self.ready, for_all=True),
            Route("GET", PATH, self.own),
            Route("GET", PATH + "/{process}", self.of_process),
            Route("GET", PATH + "/{user}/{environment}", self.of_environment),
            Route("GET", PATH + "/targets", self.targets),  # after {process}, which it would be too
        )

    async def alive(self, call: Call) -> Answer:
        return Answer(Health("ok"))

    async def ready(self, call: Call) -> Answer:
        missing = await self._master.missing()
        return Answer(Health("missing", missing), 503) if missing else Answer(Health("ok"))

    async def own(self, call: Call) -> Answer:
        platform(call, "metrics.read")
        return _text(self._master.own_metrics())

    async def of_process(self, call: Call) -> Answer:
        return await self._of(call, call.path["process"])

    async def of_environment(self, call: Call) -> Answer:
        return await self._of(call, f"{call.path['user']}/{call.path['environment']}")

    async def _of(self, call: Call, name: str) -> Answer:
        platform(call, "metrics.read")
        if name not in self._master.state.processes:
            raise NotFound(f"there is no process {name[:200]!r}")
        return _text(await self._master.metrics_of(name))

    async def targets(self, call: Call) -> Answer:
        """Each process that has joined, and the Master, all at this address."""
        platform(call, "metrics.read")
        here = call.request.getHeader("host") or ""
        scheme = "https" if call.request.isSecure() else "http"
        state = self._master.state
        joined = sorted((each.name, each.role) for each in state.processes if each.name in state.joined)
        found = [_target(here, scheme, "master", "master", PATH)]
        found += [_target(here, scheme, name, role, f"{PATH}/{quote(name)}") for name, role in joined]
        return Answer(found)


def _target(here: str, scheme: str, name: str, role: str, path: str) -> Target:
    labels = {"__scheme__": scheme, "__metrics_path__": path, "instance": name, "role": role}
    return Target([here], labels | ({"user": name.partition("/")[0]} if role == "environment" else {}))


def _text(families: list[metrics.Family]) -> Answer:
    return Answer(exposition.text(families), headers={"content-type": exposition.CONTENT_TYPE})
