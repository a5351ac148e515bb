"""World of a fake engine, which is a `FakeMachine`."""

from collections.abc import Callable

from containers.engine import Engine, EnvironmentEnded
from containers.fake import FakeEngine, FakeMachine
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import StartFailed
from tests.support.containers.engine_contract import CAPACITY, FEATURES, World


class FakeWorld(World):
    def __init__(self) -> None:
        self.machine = FakeMachine()

    def engine(self, ended: Callable[[EnvironmentEnded], None]) -> Engine:
        return FakeEngine(CAPACITY, FEATURES, ended, self.machine)

    def break_start(self, engine: Engine) -> None:
        async def launch(spec: EnvironmentSpec) -> None:
            self.machine.leftovers[spec.name] = spec.run
            raise StartFailed(f"environment {spec.name} did not start")

        engine.launch = launch  # type: ignore[method-assign]

    async def end(self, name: str) -> None:
        self.machine.end(name, 3)

    def remains(self) -> set[str]:
        return {*self.machine.running, *self.machine.leftovers}

    def alive(self) -> dict[str, str]:
        return {name: each.run for name, each in self.machine.running.items()}
