"""The agents of a swarm's nodes towards their task set, without a swarm."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from twisted.internet.base import ReactorBase

from containers import swarm_agents as module
from containers.swarm_agents import ROLE, Agents
from rce import __version__
from rce.calls.agents import NodeReport
from rce.calls.joining import Hello
from rce.calls.watching import Metrics, ReadMetrics
from rce.control import Control, Handlers, connect


@pytest.fixture
async def agents(reactor: ReactorBase) -> AsyncIterator[tuple[Agents, list[Control]]]:
    """Those of the nodes `well`, which tells its metrics, `mute` and `old`, which does not know the question."""
    agents, controls = Agents("secret", lambda node: None, lambda handlers: None), list[Control]()
    port = await agents.listen(reactor, "tcp:0:interface=127.0.0.1")

    async def never(_: ReadMetrics) -> Metrics:
        return await asyncio.get_running_loop().create_future()

    for node in ("well", "mute", "old"):
        handlers = Handlers()
        if node == "well":
            handlers.tell_metrics(ROLE)
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


async def test_metrics_are_those_of_the_agents_that_tell_any(
    agents: tuple[Agents, list[Control]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PATIENCE", 0.2)
    told = await agents[0].metrics()
    assert list(told) == ["well"]
    assert "process_resident_memory_bytes" in {family.name for family in told["well"]}
