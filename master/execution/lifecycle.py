"""Lifecycle of environments and nodes: they become ready, die, are reported to their users, and are started again."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Literal

from twisted.logger import Logger

from master.execution.effect_runner import Answer, EffectRunner, new_id, raise_first_error
from master.execution.node_ends import NodeEnds
from master.graph import reconcile, wiring
from master.graph.effects import Plan
from master.graph.records import Environment, Process, Ref, ref, user_of
from master.graph.translation import node_spec, parameter_spec, recorder_spec
from rce.control.calls.call import BatchResult, Nothing
from rce.control.calls.endpoints import Launched, NodeDied, RecorderEnded, Sync
from rce.control.calls.environments import EnvironmentDied, LimitReached, StartEnvironment
from rce.control.connection import Handlers
from rce.errors import ErrorInfo, RceError, StartFailed, clipped
from rce.protocol.messages import EnvironmentEvent, LimitEvent, RecorderEvent

RETRY_FIRST, RETRY_MOST = 0.5, 30.0  # seconds
RESETTLED_AT_ONCE = 50  # environments: a tenth of a second, in which a Master with 1,000 machines answers nobody
STEADY = 5.0  # seconds; what ran this long before it died did start, so it is started again

log = Logger()


class Lifecycle:
    """Applies plans, and acts on the answers: endpoints that are in sync, environments that did not start."""

    def __init__(self, runner: EffectRunner) -> None:
        self._runner = runner
        self._state = runner.state
        self._readiness = runner.readiness
        self._will_resettle = False
        self._retries: dict[str, float] = {}  # seconds to the next start of environments that keep dying
        self._state.environments.watchers.append(self._environment_changed)
        self._node_ends = NodeEnds(runner, self.apply)

    def add_machine_handlers(self, handlers: Handlers) -> None:
        """Answer the reports of a task set."""
        handlers.on(EnvironmentDied, self._environment_died)
        handlers.on(LimitReached, self._limit_reached)

    def add_environment_handlers(self, handlers: Handlers, process: Process) -> None:
        """Answer the reports of an Environment endpoint."""
        handlers.on(NodeDied, lambda call: self._node_ends.node_died(process, call))
        handlers.do(RecorderEnded, lambda call: self._recorder_ended(process, call))
        handlers.on(Launched, lambda call: self._node_ends.launched(process, call))

    # --- plans --------------------------------------------------------------------------------------------------------

    def apply(self, plan: Plan) -> None:
        """Save what changed and run a plan in the background; errors go to the users whom they concern."""
        self._runner.save()
        for sequence in plan:  # each by itself, so that a slow one does not delay what follows from the others
            self._runner.keep(asyncio.create_task(self._follow(self._runner.run([sequence]))))

    def resettle(self) -> None:
        """Place environments that wait for a machine, because there may be room now; many of them in several turns."""
        plan = reconcile.resettle(self._state, new_id, RESETTLED_AT_ONCE)
        self.apply(plan)
        if len(plan) >= RESETTLED_AT_ONCE:
            self._resettle_after(0)

    def resettle_soon(self) -> None:
        """Resettle in a moment: when many machines are lost at once, or all environments of one, once for all."""
        self._resettle_after(RETRY_FIRST)

    def _resettle_after(self, seconds: float) -> None:
        if not self._will_resettle:
            self._will_resettle = True
            self._runner.later(seconds, self._resettle_now)

    async def _resettle_now(self) -> None:
        self._will_resettle = False
        self.resettle()

    async def _follow(self, running: asyncio.Task[list[Answer]]) -> None:
        answers = await running
        self.handle(answers)
        raise_first_error(answers)

    def handle(self, answers: Iterable[Answer]) -> None:
        """Act on the answers of a plan."""
        for send, result in answers:
            match send.call, result:
                case Sync() as sync, BatchResult(failed):
                    self._synced(send.to, sync, failed)
                case StartEnvironment(spec), RceError() as error:
                    self._died(EnvironmentDied(spec.name, spec.run, str(error)))

    # --- ready --------------------------------------------------------------------------------------------------------

    def _synced(self, process: str, sync: Sync, failed: dict[str, ErrorInfo]) -> None:
        """Mark ready what an endpoint has now; what failed there fails for whoever waits for it."""
        state = self._state
        links = {route.link for route in sync.routes}
        for spec in sync.interfaces:
            interface = state.interfaces.get(f"{spec.owner}/{spec.tag}")
            if interface is not None and interface.id == spec.id:
                self._conclude(ref(interface), failed.get(spec.id), spec.owner)
                for connection in state.connections.by(interface.key):
                    if connection.link in links:
                        self._readiness.mark_ready(ref(connection))
        environment = state.environments.get(process)
        if environment is None:
            return
        for node in state.nodes.by(process):
            if node_spec(node) in sync.nodes:
                self._conclude(ref(node), failed.get(f"node:{node.tag}"), process)
        for parameter in state.parameters.by(process):
            spec_of = parameter_spec(parameter)
            if spec_of in sync.parameters:
                self._conclude(ref(parameter), failed.get(f"parameter:{spec_of.key}"), process)
        for recorder in state.recorders.by(process):
            if recorder_spec(recorder) in sync.recorders:
                self._conclude(ref(recorder), failed.get(f"recorder:{recorder.tag}"), process)
        self._readiness.mark_ready(ref(environment))
        ready = EnvironmentEvent(process.partition("/")[2], "ready", address=environment.address)
        self._runner.tell(user_of(process), ready)

    def _conclude(self, wanted: Ref, error: ErrorInfo | None, owner: str) -> None:
        if error is None:
            self._readiness.mark_ready(wanted)
        elif not self._readiness.fail(wanted, RceError.from_info(clipped(error))):
            self._runner.tell(user_of(owner), error=clipped(error))

    # --- environments that end ----------------------------------------------------------------------------------------

    async def _environment_died(self, call: EnvironmentDied) -> Nothing:
        self._died(call)
        return Nothing()

    def _died(self, call: EnvironmentDied) -> None:
        """An environment ended or did not start: take it down and retry after a pause."""
        environment = self._state.environments.get(call.name)
        if environment is None or environment.run != call.run:
            return  # an earlier life
        lived = self._readiness.is_ready(ref(environment))
        self.take_down(environment, call.reason)
        if call.name in self._state.environments:
            self._runner.later(self._pause(call.name, lived), lambda: self._restart(call.name, call.run))
        else:
            self.resettle()

    def take_down(self, environment: Environment, reason: str) -> None:
        """Take an environment's connections down, and tell its user the reason."""
        name = environment.name
        log.warn("environment {name} died: {reason}", name=name, reason=reason)
        lived = self._readiness.is_ready(ref(environment))
        # A command that waits for the first start removes the environment; then there is nothing to restart.
        self._readiness.fail(ref(environment), StartFailed(f"environment {name}: {reason}"))
        for each in self._inside(environment):
            self._readiness.forget(each)
        self.apply(reconcile.environment_down(self._state, environment))
        kept = name in self._state.environments
        event: Literal["failed", "lost", "gone"] = "failed" if not lived else "lost" if kept else "gone"
        self._runner.tell(user_of(name), EnvironmentEvent(name.partition("/")[2], event, reason))

    def _inside(self, environment: Environment) -> list[Ref]:
        state, name = self._state, environment.name
        return [
            ref(environment),
            *map(ref, state.nodes.by(name)),
            *map(ref, state.parameters.by(name)),
            *map(ref, state.recorders.by(name)),
            *map(ref, state.interfaces.by(name)),
            *map(ref, wiring.connections_of(state, name)),
        ]

    def _recorder_ended(self, process: Process, call: RecorderEnded) -> None:
        """Remove a recorder that cannot go on, so that its tag is free, and tell its user the reason."""
        environment = self._state.environments.get(process.name)
        recorder = self._state.recorders.get(f"{process.name}/{call.recorder}")
        if recorder is None or environment is None or process.incarnation != environment.run:
            return
        self._state.recorders.drop(recorder.key)
        self.apply([])
        tag = process.name.partition("/")[2]
        self._runner.tell(user_of(process.name), RecorderEvent(tag, call.recorder, call.reason))

    async def _restart(self, name: str, run: str) -> None:
        environment = self._state.environments.get(name)
        if environment is not None and environment.run == run:
            self.apply(reconcile.restart(self._state, environment, new_id))

    def _pause(self, key: str, lived: bool) -> float:
        """Return the seconds to the next start, which double with each failure in a row."""
        pause = RETRY_FIRST if lived else min(RETRY_MOST, 2 * self._retries.get(key, RETRY_FIRST))
        self._retries[key] = pause
        return pause

    def _environment_changed(self, before: Environment | None, after: Environment | None) -> None:
        if before is not None and after is None:
            self._retries.pop(before.name, None)

    async def _limit_reached(self, call: LimitReached) -> Nothing:
        environment = self._state.environments.get(call.name)
        if environment is not None and environment.run == call.run:
            tag = call.name.partition("/")[2]
            self._runner.tell(user_of(call.name), LimitEvent(f"environment {tag}: {call.reason}"))
        return Nothing()
