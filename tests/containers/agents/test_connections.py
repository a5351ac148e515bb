"""Connections of the task set to the agents, without a swarm."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from twisted.internet.base import ReactorBase

from containers.agents import connections as module
from containers.agents.connections import ROLE, Agents
from rce import __version__
from rce.control.calls.agents import NodeReport, SetMaster
from rce.control.calls.joining import Hello, SetRemovedMachines
from rce.control.calls.watching import Metrics, ReadMetrics
from rce.control.client import connect
from rce.control.connection import Control, Handlers


@pytest.fixture
def told() -> asyncio.Queue[SetRemovedMachines]:
    """The removals of which agents were told."""
    return asyncio.Queue()


@pytest.fixture
async def agents(
    reactor: ReactorBase, told: asyncio.Queue[SetRemovedMachines]
) -> AsyncIterator[tuple[Agents, list[Control]]]:
    """Agents `well`, which sends its metrics, `mute`, which never answers, and `old`, which does not know the call."""
    agents, controls = Agents("secret", lambda node: None, lambda handlers: None), list[Control]()
    port = await agents.listen(reactor, "tcp:0:interface=127.0.0.1")

    async def never(_: ReadMetrics) -> Metrics:
        future: asyncio.Future[Metrics] = asyncio.get_running_loop().create_future()
        return await future

    for node in ("well", "mute", "old"):
        handlers = Handlers()
        handlers.do(SetRemovedMachines, told.put_nowait)
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


@pytest.mark.slow
async def test_metrics_of_agents_that_do_not_answer_are_left_out(
    agents: tuple[Agents, list[Control]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "METRICS_TIMEOUT", 5.0)  # the agent that answers may need some time on a busy machine
    metrics = await agents[0].metrics()
    assert list(metrics) == ["well"]
    assert "process_resident_memory_bytes" in {family.name for family in metrics["well"]}


async def test_agents_are_told_of_removed_machines_at_once_and_when_they_join(
    reactor: ReactorBase, agents: tuple[Agents, list[Control]], told: asyncio.Queue[SetRemovedMachines]
) -> None:
    agents[0].set_removed_machines({"m7": 5.0})
    for _ in range(3):
        assert await asyncio.wait_for(told.get(), 60) == SetRemovedMachines({"m7": 5.0})
    handlers = Handlers()
    handlers.do(SetRemovedMachines, told.put_nowait)
    port = agents[1][0].address  # of the task set
    control, _ = await connect(reactor, port, Hello(ROLE, "new", "secret", __version__), handlers)
    assert await asyncio.wait_for(told.get(), 60) == SetRemovedMachines({"m7": 5.0})
    agents[1].append(control)


async def test_agents_are_told_which_master_leads_at_once_and_when_they_join(
    reactor: ReactorBase, agents: tuple[Agents, list[Control]]
) -> None:
    agents[0].set_master("tcp:b:8080")
    told: asyncio.Queue[SetMaster] = asyncio.Queue()
    handlers = Handlers()
    handlers.do(SetMaster, told.put_nowait)
    port = agents[1][0].address  # of the task set
    control, _ = await connect(reactor, port, Hello(ROLE, "new", "secret", __version__), handlers)
    agents[1].append(control)
    assert await asyncio.wait_for(told.get(), 60) == SetMaster("tcp:b:8080")
    agents[0].set_master("tcp:a:8080")
    assert await asyncio.wait_for(told.get(), 60) == SetMaster("tcp:a:8080")


async def test_relay_of_a_node_is_known_while_its_agent_is_away(agents: tuple[Agents, list[Control]]) -> None:
    assert agents[0].relays == dict.fromkeys(("well", "mute", "old"), "127.0.0.1:1")
    agents[1][0].close()
    async with asyncio.timeout(60):
        while agents[0].report("well") is not None:  # noqa: ASYNC110  # it has no event of its own
            await asyncio.sleep(0)
    assert agents[0].relays["well"] == "127.0.0.1:1"
