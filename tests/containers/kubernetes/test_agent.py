"""The agent of a node, with pods that are stand-ins."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from twisted.internet.base import ReactorBase

from containers.kubernetes import agent as module
from containers.kubernetes import network, process
from containers.kubernetes.agent import Agent, Settings
from rce.control.calls.agents import ConnectGroup, Furnish, RemoveRun
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.control.calls.watching import MeasureUsage
from rce.errors import NotFound, StartFailed
from rce.protocol.messages import ContainerData, Rates

RUN, FIRST = "1" * 32, 4711
GROUP = Group("ann/pair", "10.128.0.0/24", "10.128.0.2", {"map": "10.128.0.2"})
CALL = Furnish(EnvironmentSpec("ann/map", RUN, "", ContainerData(size=2)), "c0ffee", 1000)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is done to pods, whose first process is FIRST."""
    steps: list[str] = []
    monkeypatch.setattr(process, "first_process", lambda container: FIRST)
    monkeypatch.setattr(process, "is_alive", lambda first, container: container == "c0ffee")
    monkeypatch.setattr(process, "used", lambda first: None)
    monkeypatch.setattr(process, "limit", lambda *given: steps.append(f"limit {given[0]} to {given[1]} processes"))
    monkeypatch.setattr(network, "confine", lambda first, egress, group: steps.append(f"confine {first} to {egress}"))
    monkeypatch.setattr(network, "connect", lambda *given: steps.append(f"connect to {given[3]}"))
    monkeypatch.setattr(module, "apply", lambda request: steps.append(f"apply {request.io.read}"))
    return steps


def agent(reactor: ReactorBase, root: Path) -> Any:
    settings = Settings(
        master="tcp:127.0.0.1:1",
        task_set="tcp:127.0.0.1:1",
        token="secret",
        node="n1",
        address="127.0.0.1",
        root=root,
        seccomp=root / "seccomp",
    )
    (root / "runs" / RUN / "control").mkdir(parents=True, exist_ok=True)  # as kubelet does
    (root / "users").mkdir(exist_ok=True)
    return Agent(reactor, settings)


async def test_environment_is_confined_before_it_is_served(
    reactor: ReactorBase, tmp_path: Path, steps: list[str]
) -> None:
    made = agent(reactor, tmp_path)
    await asyncio.gather(made._furnish(CALL), made._furnish(CALL))
    assert steps == ["confine 4711 to none", "limit 4711 to 1024 processes"]
    assert made._services.served == {RUN}
    await made._furnish(CALL)
    assert len(steps) == 2, "a repeated call changes nothing"
    await made._remove_run(RemoveRun(RUN))


async def test_failed_confinement_leaves_the_environment_unserved(
    reactor: ReactorBase, tmp_path: Path, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError("no such process")

    monkeypatch.setattr(process, "limit", fail)
    made = agent(reactor, tmp_path)
    with pytest.raises(StartFailed, match="ann/map did not start: no such process"):
        await made._furnish(CALL)
    assert made._services.served == set()
    await made._remove_run(RemoveRun(RUN))


async def test_next_agent_serves_what_still_runs(reactor: ReactorBase, tmp_path: Path, steps: list[str]) -> None:
    first = agent(reactor, tmp_path)
    await first._furnish(CALL)
    first._services.stop_serving(RUN)
    second = agent(reactor, tmp_path)
    await second._recover()
    assert second._services.served == {RUN}
    assert len(steps) == 2, "it is confined already"
    await second._remove_run(RemoveRun(RUN))


async def test_next_agent_does_not_serve_what_has_ended(reactor: ReactorBase, tmp_path: Path, steps: list[str]) -> None:
    made = agent(reactor, tmp_path)
    made._places.record(RUN).write_text("{}")  # of another version
    await made._recover()
    await made._furnish(replace(CALL, container="ended"))
    made._services.stop_serving(RUN)
    again = agent(reactor, tmp_path)
    await again._recover()
    assert again._services.served == set()


async def test_removal_leaves_nothing(reactor: ReactorBase, tmp_path: Path, steps: list[str]) -> None:
    made = agent(reactor, tmp_path)
    await made._furnish(CALL)
    assert (await made._remove_run(RemoveRun(RUN))).found
    assert not made._places.control(RUN).parent.exists()
    assert not (await made._remove_run(RemoveRun(RUN))).found
    with pytest.raises(NotFound):
        await made._remove_run(RemoveRun("../.."))


async def test_limits_from_outside_are_applied_if_asked_for(
    reactor: ReactorBase, tmp_path: Path, steps: list[str]
) -> None:
    made = agent(reactor, tmp_path)
    options = ContainerData(io=Rates(read=5))
    await made._furnish(replace(CALL, environment=replace(CALL.environment, options=options)))
    assert steps[-1] == "apply 5"
    await made._remove_run(RemoveRun(RUN))


async def test_group_has_names_and_peers(reactor: ReactorBase, tmp_path: Path, steps: list[str]) -> None:
    made = agent(reactor, tmp_path)
    await made._furnish(replace(CALL, environment=replace(CALL.environment, group=GROUP)))
    members = {"map": "10.128.0.2", "plan": "10.128.0.3"}
    await made._connect_group(ConnectGroup(RUN, members, ["10.1.0.5"]))
    assert steps[-1] == "connect to ['10.1.0.5']"
    assert "10.128.0.3\tplan" in made._places.hosts(RUN).read_text()
    await made._remove_run(RemoveRun(RUN))
    with pytest.raises(NotFound, match="no group"):
        await made._connect_group(ConnectGroup(RUN, members, []))


async def test_later_members_of_a_group_follow_earlier_ones(
    reactor: ReactorBase, tmp_path: Path, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = agent(reactor, tmp_path)
    await made._furnish(replace(CALL, environment=replace(CALL.environment, group=GROUP)))
    going = threading.Event()

    def connect(*given: Any) -> None:
        if given[3] == ["10.1.0.5"]:
            assert going.wait(10)
        steps.append(f"connect to {given[3]}")

    monkeypatch.setattr(network, "connect", connect)
    first = asyncio.create_task(made._connect_group(ConnectGroup(RUN, {}, ["10.1.0.5"])))
    await asyncio.sleep(0)
    second = asyncio.create_task(made._connect_group(ConnectGroup(RUN, {}, ["10.1.0.6"])))
    await asyncio.sleep(0.1)  # in which the second would have been carried out
    going.set()
    await asyncio.gather(first, second)
    assert steps[-2:] == ["connect to ['10.1.0.5']", "connect to ['10.1.0.6']"]
    await made._remove_run(RemoveRun(RUN))


async def test_usage_leaves_out_what_has_ended(reactor: ReactorBase, tmp_path: Path, steps: list[str]) -> None:
    made = agent(reactor, tmp_path)
    await made._furnish(CALL)
    assert (await made._measure_usage(MeasureUsage())).environments == {}
    await made._remove_run(RemoveRun(RUN))
