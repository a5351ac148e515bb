"""The agent of a node reports the environments that it finds at its start."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from containers.docker.daemon import State
from containers.swarm.agent import Agent
from rce.control.calls.agents import ContainerEnded, NodeReport

RUN, NEW_RUN = "1" * 32, "2" * 32


class Docker:
    """Daemon with running containers of these runs, but those that have `ended`."""

    def __init__(self, *runs: str) -> None:
        self.runs = list(runs)
        self.ended: set[str] = set()

    async def tasks(self) -> list[Any]:
        return [
            SimpleNamespace(run=run, name=f"ann/{run[0]}", running=run not in self.ended, ended=run in self.ended)
            for run in self.runs
        ]

    async def state(self, run: str) -> State:
        return State(3, out_of_memory=False, memory=0)

    async def last_lines(self, run: str, count: int) -> list[str]:
        return []

    async def images(self) -> list[str]:
        return []

    async def sweep(self, runs: set[str]) -> None:
        assert runs == set(self.runs)


def make_agent(docker: Docker, reports: list[Any], served: asyncio.Event) -> Any:
    """Return an agent that has just started and takes its time to serve environments."""
    agent: Any = Agent.__new__(Agent)

    async def prepare(task: Any) -> None:
        await served.wait()
        agent._services.served.add(task.run)
        del agent._preparing[task.run]

    async def notify(report: NodeReport | ContainerEnded) -> None:
        reports.append(report)

    agent._docker, agent._prepare = docker, prepare
    agent._dead, agent._end_reported, agent._present = set(), set(), set()
    agent._preparing, agent._adopted = {}, None
    agent._restore_rules, agent._report = False, None
    agent._services = SimpleNamespace(
        served=set[str](), relay="10.0.0.1:1", link=SimpleNamespace(connected=True), notify=notify
    )
    return agent


async def test_environments_found_at_the_start_are_reported_at_once() -> None:
    """Else a task set that starts at the same time removes them."""
    docker, reports, served = Docker(RUN), list[NodeReport](), asyncio.Event()
    agent = make_agent(docker, reports, served)
    await agent._check()
    assert reports[-1].runs == [RUN]
    docker.runs.append(NEW_RUN)
    await agent._check()
    assert reports[-1].runs == [RUN], "a new environment is reported when it is served"
    served.set()
    await asyncio.gather(*agent._preparing.values())
    await agent._check()
    assert reports[-1].runs == [RUN, NEW_RUN]


async def test_ends_are_reported_before_the_report_that_lacks_them() -> None:
    """Else the task set takes them for ends that nobody saw, without status and last words."""
    docker, reports = Docker(RUN), list[Any]()
    docker.ended.add(RUN)
    agent = make_agent(docker, reports, asyncio.Event())
    agent._services.link.connected = False

    async def join(runs: set[str]) -> None:
        agent._services.link.connected = True

    docker.sweep = join  # type: ignore[method-assign]
    await agent._check()
    assert reports == []
    await agent._check()
    assert [type(each) for each in reports] == [ContainerEnded, NodeReport]
