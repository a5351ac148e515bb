"""Process tracker: which processes are connected; those that are lost have a grace period to come back."""

from __future__ import annotations

import asyncio

from twisted.logger import Logger

from master.execution.effect_runner import EffectRunner, new_id
from master.execution.lifecycle import Lifecycle
from master.graph import reconcile, sessions
from master.graph.effects import Plan
from master.graph.placement import place
from master.graph.records import Process, Robot, ref, user_of
from master.graph.state import at
from master.live.events import Events
from master.live.view_cache import ViewCache
from rce.control.calls.joining import Hello
from rce.control.connection import Control
from rce.errors import NoCapacity

log = Logger()

CUT_OFF = 600.0  # seconds for which robots are kept whose endpoint fell silent: it may serve them behind a cut line


class ProcessTracker:
    """Tracks processes; `grace` is that of Robot endpoints and robots, `machine_grace` that of machines, in seconds."""

    def __init__(
        self,
        runner: EffectRunner,
        lifecycle: Lifecycle,
        events: Events,
        view_cache: ViewCache,
        grace: float,
        machine_grace: float,
    ) -> None:
        self.grace = grace
        self.machine_grace = machine_grace
        self._runner = runner
        self._state = runner.state
        self._controls = runner.dispatcher.controls
        self._lifecycle = lifecycle
        self._events = events
        self._view_cache = view_cache
        self._away: dict[str, asyncio.Task[None]] = {}  # running grace periods by process

    def begin(self) -> None:
        """Begin with the processes of an earlier Master, which have twice their grace period to join."""
        for process in self._state.processes:
            self._begin_grace(process, 2)
        self._drop_later(2 * self.grace)

    def joined(self, process: Process, hello: Hello, control: Control) -> None:
        """Take a process that has joined, and reconcile what it has with the records."""
        log.info("{role} {name} joined from {address}", role=process.role, name=process.name, address=control.address)
        old = self._controls.get(process.name)
        self._controls[process.name] = control
        if old is not None:
            old.close()
        control.lost.add_done_callback(lambda _: self._lost(process, control))
        if process.name in self._away:
            self._away.pop(process.name).cancel()
        self._events.process_moved(process, True)
        self._lifecycle.apply(reconcile.joined(self._state, process, hello, new_id))
        self._view_cache.process_moved(process.name)
        self._drop_later(self.grace)
        if process.role == "container":
            self._refuse_unplaceable()

    def _lost(self, process: Process, control: Control) -> None:
        if self._controls.get(process.name) is not control:
            return  # it has joined again
        del self._controls[process.name]
        log.info("{role} {name} is away", role=process.role, name=process.name)
        self._events.process_moved(process, False)
        reconcile.left(self._state, process.name)
        self._view_cache.process_moved(process.name)
        if process.name not in self._state.processes:
            return
        if control.fell_silent and process.role == "robot":
            self._state.expected.add(process.name)
            self._away[process.name] = self._runner.later(self.grace, lambda: self._endpoint_cut_off(process.name))
        else:
            self._begin_grace(process)

    async def evict(self, name: str) -> None:
        """Disconnect a process that may not join any more, with the environments of its machine, and give it up."""
        reason = f"its machine {name} was removed"
        environments = [environment.name for environment in self._state.environments.by(at(name))]
        for each in (name, *environments):
            self._disconnect(each)
        for environment in reconcile.lost_with(self._state, name):
            self._lifecycle.take_down(environment, reason)
        await self._give_up(name)

    def _disconnect(self, name: str) -> None:
        control, process = self._controls.pop(name, None), self._state.processes.get(name)
        if control is not None and process is not None:
            log.warn("{role} {name} is disconnected: it was removed", role=process.role, name=name)
            control.close()
            self._events.process_moved(process, False)
        if name in self._away:
            self._away.pop(name).cancel()
        reconcile.left(self._state, name)
        self._state.expected.discard(name)
        self._view_cache.process_moved(name)

    async def _give_up(self, name: str) -> None:
        process = self._state.processes.get(name)
        if process is not None and process.role == "robot":
            await self._endpoint_gone(name)
        else:
            reconcile.machine_removed(self._state, name)
            self._view_cache.process_moved(name)
            self._refuse_unplaceable()
            self._lifecycle.resettle_soon()

    def _begin_grace(self, process: Process, times: float = 1) -> None:
        name = process.name
        self._state.expected.add(name)
        if process.role == "robot":
            self._away[name] = self._runner.later(times * self.grace, lambda: self._endpoint_gone(name))
        else:
            self._away[name] = self._runner.later(times * self.machine_grace, lambda: self._machine_gone(name))

    async def _machine_gone(self, name: str) -> None:
        """Take down the environments of a task set, or of an Environment endpoint, that did not come back."""
        self._away.pop(name, None)
        self._state.expected.discard(name)
        self._view_cache.process_moved(name)
        for environment in reconcile.lost_with(self._state, name):
            reason = f"its machine {environment.machine} has been away for {self.machine_grace:g} s"
            self._lifecycle.take_down(environment, reason)
        self._refuse_unplaceable()
        self._lifecycle.resettle_soon()

    def _refuse_unplaceable(self) -> None:
        """Fail commands that wait for a machine that was expected back and is not any more."""
        for environment in self._state.environments.by(at("")):
            try:
                place(self._state, user_of(environment.name), environment.options)
            except NoCapacity as error:
                self._runner.readiness.fail(ref(environment), error)

    async def _endpoint_cut_off(self, name: str) -> None:
        """Expect a silent Robot endpoint no longer, but keep its robots: they may be connected to it all the while.

        Their names are free for robots that connect elsewhere.
        """
        self._state.expected.discard(name)
        self._view_cache.process_moved(name)
        self._away[name] = self._runner.later(CUT_OFF, lambda: self._endpoint_gone(name))

    async def _endpoint_gone(self, name: str) -> None:
        """Remove the robots of a Robot endpoint that did not come back."""
        self._away.pop(name, None)
        self._state.expected.discard(name)
        self._view_cache.process_moved(name)
        plan, robots = sessions.endpoint_gone(self._state, name)
        for robot in robots:
            plan += sessions.robot_left(self._state, robot)
        self._lifecycle.apply(plan)

    def _drop_later(self, seconds: float) -> None:
        """Remove robots without an endpoint unless they appear at one within `seconds`."""
        robots = sessions.stranded(self._state)
        if robots:
            self._runner.later(seconds, lambda: self._drop(robots))

    async def _drop(self, robots: list[Robot]) -> None:
        plan: Plan = []
        for robot in robots:
            if self._state.robots.get(robot.name) == robot:  # unchanged: it did not come back meanwhile
                plan += sessions.robot_left(self._state, robot.name)
        self._lifecycle.apply(plan)
