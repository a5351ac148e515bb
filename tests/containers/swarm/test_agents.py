"""Connections of the task set to the agents of a swarm, without a swarm."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from twisted.internet.base import ReactorBase

from containers.swarm import agents as module
from containers.swarm.agents import ROLE, Agents
from rce import __version__
from rce.control.calls.agents import NodeReport
from rce.control.calls.joining import Hello
from rce.control.calls.watching import Metrics, ReadMetrics
from rce.control.client import connect
from rce.control.connection import Control, Handlers


@pytest.fixture
async def agents(reactor: ReactorBase) -> AsyncIterator[tuple[Agents, list[Control]]]:
    """Agents `well`, which sends its metrics, `mute`, which never answers, and `old`, which does not know the call."""
    agents, controls = Agents("secret", lambda node: None, lambda handlers: None), list[Control]()
    port = await agents.listen(reactor, "tcp:0:interface=127.0.0.1")

    async def never(_: ReadMetrics) -> Metrics:
        future: asyncio.Future[Metrics] = asyncio.get_running_loop().create_future()
        return await future

    for node in ("well", "mute", "old"):
        handlers = Handlers()
        if node == "well":
            handlers.serve_metrics(ROLE)
        elif node == "mute":
            handlers.on(ReadMetrics, never)
        hello = Hello(ROLE, node, "secret", __version__)
        control, _ = await connect(reactor, f"tcp:127.0.0.1:{port}", hello, handlers)
        await control.call(NodeReport([], {}, True, "127.0.0.1:1"))
        controls.append(control)
    yield agents, controls
    await agents.close()
    for control in controls:
        control.close()
        await control.lost


async def test_metrics_of_agents_that_do_not_answer_are_left_out(
    agents: tuple[Agents, list[Control]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "METRICS_TIMEOUT", 2.0)  # the agent that answers may need some time on a busy machine
    metrics = await agents[0].metrics()
    assert list(metrics) == ["well"]
    assert "process_resident_memory_bytes" in {family.name for family in metrics["well"]}
