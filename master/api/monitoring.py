"""`/healthz`, `/readyz` and `/metrics`, for supervisors and Prometheus.

Prometheus needs to reach only the Master, which reads the metrics of other processes over their control connections.
"""

from __future__ import annotations

from urllib.parse import quote

from msgspec import Struct

from master.api.principals import authorize_platform
from master.api.request import Answer, Call
from master.api.router import Api, Route
from master.service import Master
from rce.errors import NotFound
from rce.process import exposition, metrics
from rce.web.health import health
from rce.web.requests import header

PATH = "/metrics"


class Target(Struct, frozen=True):
    """Scrape target in the format of Prometheus' HTTP service discovery."""

    targets: list[str]
    labels: dict[str, str]


class Monitoring:
    """Routes outside the API's prefix, at the paths where monitoring expects them."""

    def __init__(self, master: Master) -> None:
        self._master = master

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add_outside_prefix(
            Route("GET", "/healthz", self._report_alive, public=True),
            Route("GET", "/readyz", self._report_ready, public=True),
            Route("GET", PATH, self._own_metrics),
            Route("GET", PATH + "/{process}", self._process_metrics),
            Route("GET", PATH + "/{user}/{environment}", self._environment_metrics),
            Route("GET", PATH + "/targets", self._scrape_targets),  # takes precedence over {process}
        )

    async def _report_alive(self, call: Call) -> Answer:
        return Answer(*health([]))

    async def _report_ready(self, call: Call) -> Answer:
        return Answer(*health(await self._master.missing()))

    async def _own_metrics(self, call: Call) -> Answer:
        authorize_platform(call, "metrics.read")
        return _prometheus(self._master.own_metrics())

    async def _process_metrics(self, call: Call) -> Answer:
        return await self._metrics_of(call, call.path["process"])

    async def _environment_metrics(self, call: Call) -> Answer:
        return await self._metrics_of(call, f"{call.path['user']}/{call.path['environment']}")

    async def _metrics_of(self, call: Call, name: str) -> Answer:
        authorize_platform(call, "metrics.read")
        if name not in self._master.state.processes:
            raise NotFound(f"there is no process {name[:200]!r}")
        return _prometheus(await self._master.metrics_of(name))

    async def _scrape_targets(self, call: Call) -> Answer:
        """List the Master and all processes that have joined, all at the Master's address."""
        authorize_platform(call, "metrics.read")
        host = header(call.request, "Host") or ""
        scheme = "https" if call.request.secure else "http"
        state = self._master.state
        joined = sorted((each.name, each.role) for each in state.processes if each.name in state.joined)
        found = [_target(host, scheme, "master", "master", PATH)]
        found += [_target(host, scheme, name, role, f"{PATH}/{quote(name)}") for name, role in joined]
        return Answer(found)


def _target(host: str, scheme: str, name: str, role: str, path: str) -> Target:
    labels = {"__scheme__": scheme, "__metrics_path__": path, "instance": name, "role": role}
    return Target([host], labels | ({"user": name.partition("/")[0]} if role == "environment" else {}))


def _prometheus(families: list[metrics.Family]) -> Answer:
    return Answer(exposition.prometheus_text(families), headers={"content-type": exposition.CONTENT_TYPE})
