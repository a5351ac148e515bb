"""Environments and their nodes end by themselves: who hears of it, and when they are started again."""

from __future__ import annotations

from typing import Literal

from twisted.logger import Logger

from master import presence, wiring
from master.effects import Send
from master.records import Environment, Process, user_of, what
from master.rim import Rim, ids
from rce.calls.call import Nothing
from rce.calls.endpoints import NodeDied, StartNode
from rce.calls.environments import EnvironmentDied, LimitReached
from rce.control import Handlers
from rce.errors import RceError, StartFailed
from rce.messages import EnvironmentEvent, LimitEvent, NodeEvent

RETRY_FIRST, RETRY_MOST = 0.5, 30.0  # seconds
STEADY = 5.0  # what ran this long before it died was no failed start: it is started again

log = Logger()


class Lifecycle:
    """What is done about ends that nobody asked for."""

    def __init__(self, rim: Rim) -> None:
        self._rim = rim
        self._state = rim.state
        self._carrier = rim.carrier
        self._retries: dict[str, float] = {}  # seconds to the next start of what keeps dying

    def of_machine(self, handlers: Handlers) -> None:
        """What a task set may tell."""
        handlers.on(EnvironmentDied, self.died)
        handlers.on(LimitReached, self._limit_reached)

    def of_environment(self, handlers: Handlers, process: Process) -> None:
        """What an Environment endpoint may tell."""
        handlers.on(NodeDied, lambda call: self._node_died(process, call))

    async def died(self, call: EnvironmentDied) -> Nothing:
        """An environment ended, or did not start: it is tried again after a pause."""
        environment = self._state.environments.get(call.name)
        if environment is None or environment.run != call.run:
            return Nothing()  # an earlier life
        lived = self._carrier.is_real(what(environment))
        self.down(environment, call.reason)
        if call.name in self._state.environments:
            self._rim.later(self._pause(call.name, lived), lambda: self._restart(call.name, call.run))
        else:
            await self._rim.resettle()
        return Nothing()

    def down(self, environment: Environment, reason: str) -> None:
        """Take it out of the work, and tell its user."""
        name = environment.name
        log.warn("environment {name} died: {reason}", name=name, reason=reason)
        lived = self._carrier.is_real(what(environment))
        # A command that waits for its first start takes the environment back; then there is nothing to restart.
        self._carrier.settle(what(environment), StartFailed(f"environment {name}: {reason}"))
        for key in self._inside(environment):
            self._carrier.forget(key)
        self._rim.apply(presence.environment_down(self._state, environment))
        kept = name in self._state.environments
        event: Literal["failed", "lost", "gone"] = "failed" if not lived else "lost" if kept else "gone"
        self._rim.tell(user_of(name), EnvironmentEvent(name.partition("/")[2], event, reason))

    async def _limit_reached(self, call: LimitReached) -> Nothing:
        environment = self._state.environments.get(call.name)
        if environment is not None and environment.run == call.run:
            tag = call.name.partition("/")[2]
            self._rim.tell(user_of(call.name), LimitEvent(f"environment {tag}: {call.reason}"))
        return Nothing()

    async def _restart(self, name: str, run: str) -> None:
        environment = self._state.environments.get(name)
        if environment is not None and environment.run == run:
            self._rim.apply(presence.restart(self._state, environment, ids))

    def _inside(self, environment: Environment) -> list[str]:
        state, name = self._state, environment.name
        return [
            what(environment),
            *map(what, state.nodes.by(name)),
            *map(what, state.parameters.by(name)),
            *map(what, state.interfaces.by(name)),
            *map(what, wiring.connections_of(state, name)),
        ]

    async def _node_died(self, process: Process, call: NodeDied) -> Nothing:
        node = self._state.nodes.get(f"{process.name}/{call.node}")
        environment = self._state.environments.get(process.name)
        if node is None or environment is None:
            return Nothing()
        tag = process.name.partition("/")[2]
        self._rim.tell(user_of(process.name), NodeEvent(tag, call.node, call.status, call.lines))
        if call.status == 0 or environment.options.restart == "no" or call.seconds < STEADY:
            self._state.nodes.drop(node.key)  # it has ended, or never worked: its tag is free
            self._rim.apply([])
        else:
            self._rim.later(RETRY_FIRST, lambda: self._start_again(node.key))
        return Nothing()

    async def _start_again(self, key: str) -> None:
        node = self._state.nodes.get(key)
        if node is None:
            return
        try:
            await self._carrier.carry([[Send(node.owner, StartNode(node.spec), what(node))]])
        except RceError as error:
            if self._state.nodes.get(key) == node:
                self._state.nodes.drop(key)
                self._rim.apply([])
            self._rim.tell(user_of(key), error=error.info)

    def _pause(self, key: str, lived: bool) -> float:
        """Seconds until the next start: more with each failure in a row."""
        pause = RETRY_FIRST if lived else min(RETRY_MOST, 2 * self._retries.get(key, RETRY_FIRST))
        self._retries[key] = pause
        return pause
