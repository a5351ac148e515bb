"""Engine of fake environments that join the Master: the contract, their endpoints and their usage."""

from collections.abc import Callable

import pytest

from containers.engine import EnvironmentEnded
from containers.fake import FakeMachine
from containers.hollow import HollowEngine
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import Unauthorized
from tests.support.containers.engine_contract import CAPACITY, FEATURES, Endings, EngineContract, opened, spec
from tests.support.containers.fake_world import FakeWorld


class FakeEndpoint:
    """Connection of an endpoint, which is an entry in `connected`."""

    def __init__(self, name: str, connected: set[str]) -> None:
        self._name, self._connected = name, connected
        connected.add(name)

    def close(self) -> None:
        self._connected.discard(self._name)


class HollowWorld(FakeWorld):
    def __init__(self) -> None:
        super().__init__()
        self.connected: set[str] = set()

    def engine(self, ended: Callable[[EnvironmentEnded], None]) -> HollowEngine:
        async def join(spec: EnvironmentSpec) -> FakeEndpoint:
            return FakeEndpoint(spec.name, self.connected)

        return HollowEngine(CAPACITY, FEATURES, ended, self.machine, join)


@pytest.fixture
def world() -> HollowWorld:
    return HollowWorld()


class TestHollowEngine(EngineContract):
    pass


async def test_endpoint_is_connected_while_its_environment_runs(world: HollowWorld) -> None:
    async with opened(world.engine(Endings())) as engine:
        await engine.start(spec())
        assert world.connected == {spec().name}
        await engine.stop(spec().name)
        assert world.connected == set()


async def test_refused_endpoint_fails_the_start() -> None:
    async def join(spec: EnvironmentSpec) -> FakeEndpoint:
        raise Unauthorized("this token is not known")

    async with opened(HollowEngine(CAPACITY, FEATURES, Endings(), FakeMachine(), join)) as engine:
        with pytest.raises(Unauthorized, match="token"):
            await engine.start(spec())
        assert engine.machine.running == {}


async def test_usage_grows_with_time(world: HollowWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("containers.hollow.time.monotonic", lambda: now)
    async with opened(world.engine(Endings())) as engine:
        await engine.start(spec())
        first = (await engine.usage())["ann/map"]
        now += 10
        second = (await engine.usage())["ann/map"]
    assert (first.seconds, first.memory) == (0, 100_000_000)
    assert (second.seconds, second.memory) == (0.1, 110_000_000)
