"""What processes answer to effects: what has become real by it, and who hears of it."""

from __future__ import annotations

import asyncio

from master.effects import Send
from master.lifecycle import Lifecycle
from master.records import user_of, what
from master.rim import Rim
from rce.calls.call import Settled
from rce.calls.endpoints import Sync
from rce.calls.environments import EnvironmentDied, StartEnvironment
from rce.errors import ErrorInfo, RceError
from rce.messages import EnvironmentEvent


class Answers:
    """An environment that could not be started has died, which is the matter of `lives`."""

    def __init__(self, rim: Rim, lives: Lifecycle) -> None:
        self._rim = rim
        self._state = rim.state
        self._carrier = rim.carrier
        self._lives = lives

    def take(self, send: Send, result: object) -> None:
        match send.call, result:
            case Sync() as sync, Settled(failed):
                self._synced(send.to, sync, failed)
            case StartEnvironment(spec), RceError() as error:
                died = EnvironmentDied(spec.name, spec.run, str(error))
                self._rim.keep(asyncio.create_task(self._lives.died(died)))

    def _synced(self, process: str, sync: Sync, failed: dict[str, ErrorInfo]) -> None:
        links = {route.link for route in sync.routes}
        for spec in sync.interfaces:
            interface = self._state.interfaces.get(f"{spec.owner}/{spec.tag}")
            if interface is not None and interface.spec.id == spec.id:
                self._conclude(what(interface), failed.get(spec.id), spec.owner)
                for connection in self._state.connections.by(interface.key):
                    if connection.link in links:
                        self._carrier.settle(what(connection))
        environment = self._state.environments.get(process)
        if environment is None:
            return
        for node in self._state.nodes.by(process):
            if node.spec in sync.nodes:
                self._conclude(what(node), failed.get(f"node:{node.spec.tag}"), process)
        for parameter in self._state.parameters.by(process):
            if parameter.spec in sync.parameters:
                self._conclude(what(parameter), failed.get(f"parameter:{parameter.spec.key}"), process)
        self._carrier.settle(what(environment))
        self._rim.tell(
            user_of(process), EnvironmentEvent(process.partition("/")[2], "ready", address=environment.address)
        )

    def _conclude(self, key: str, error: ErrorInfo | None, owner: str) -> None:
        if error is None:
            self._carrier.settle(key)
        elif not self._carrier.settle(key, RceError.from_info(error)):
            self._rim.tell(user_of(owner), error=error)
