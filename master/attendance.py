"""Which processes are here: they join, are lost, have time to come back, and are given up when they do not."""

from __future__ import annotations

import asyncio

from twisted.logger import Logger

from master import presence
from master.effects import Plan
from master.events import Events
from master.lifecycle import RETRY_FIRST, Lifecycle
from master.placement import place
from master.records import Process, Robot, at, user_of, what
from master.rim import Rim, ids
from master.sight import Sight
from rce.calls.joining import Hello
from rce.control import Control
from rce.errors import NoCapacity

log = Logger()


class Attendance:
    """`grace` and `machine_grace` are the Master's; what is with a process that stays away goes down in `lives`."""

    def __init__(
        self, rim: Rim, lives: Lifecycle, events: Events, sight: Sight, grace: float, machine_grace: float
    ) -> None:
        self.grace = grace
        self.machine_grace = machine_grace
        self._rim = rim
        self._state = rim.state
        self._carrier = rim.carrier
        self._lives = lives
        self._events = events
        self._sight = sight
        self._away: dict[str, asyncio.Task[None]] = {}  # processes whose time to come back runs

    def begin(self) -> None:
        """After a start of the Master: who was here has twice its time to come back."""
        for process in self._state.processes:
            self._expect(process, 2)
        self._drop_later(2 * self.grace)

    def joined(self, process: Process, hello: Hello, control: Control) -> None:
        log.info("{role} {name} joined from {address}", role=process.role, name=process.name, address=control.address)
        old = self._carrier.controls.get(process.name)
        self._carrier.controls[process.name] = control
        if old is not None:
            old.close()
        control.lost.add_done_callback(lambda _: self._lost(process, control))
        if process.name in self._away:
            self._away.pop(process.name).cancel()
        self._events.process_moved(process, True)
        self._rim.apply(presence.joined(self._state, process, hello, ids))
        self._sight.process_moved(process.name)
        self._drop_later(self.grace)
        if process.role == "container":
            self._refuse_waiting()

    def _lost(self, process: Process, control: Control) -> None:
        if self._carrier.controls.get(process.name) is not control:
            return  # it is back already
        del self._carrier.controls[process.name]
        log.info("{role} {name} is away", role=process.role, name=process.name)
        self._events.process_moved(process, False)
        presence.left(self._state, process.name)
        self._sight.process_moved(process.name)
        if process.name in self._state.processes:
            self._expect(process)

    def _expect(self, process: Process, times: float = 1) -> None:
        """A process has its grace time, so many times, to come back."""
        name = process.name
        self._state.expected.add(name)
        if process.role == "robot":
            self._away[name] = self._rim.later(times * self.grace, lambda: self._endpoint_away(name))
        else:
            self._away[name] = self._rim.later(times * self.machine_grace, lambda: self._machine_away(name))

    async def _machine_away(self, name: str) -> None:
        """A task set or an environment's endpoint does not come back."""
        self._away.pop(name, None)
        self._state.expected.discard(name)
        self._sight.process_moved(name)
        for environment in presence.lost_with(self._state, name):
            away = f"its machine {environment.machine} has been away for {self.machine_grace:g} s"
            self._lives.down(environment, away)
        self._refuse_waiting()
        self._rim.later(RETRY_FIRST, self._rim.resettle)

    def _refuse_waiting(self) -> None:
        """What waits to be made on a machine that was expected back, and is not any more, is not made."""
        for environment in self._state.environments.by(at("")):
            try:
                place(self._state, user_of(environment.name), environment.options)
            except NoCapacity as error:
                self._carrier.settle(what(environment), error)

    async def _endpoint_away(self, name: str) -> None:
        self._away.pop(name, None)
        self._state.expected.discard(name)
        self._sight.process_moved(name)
        plan, robots = presence.endpoint_gone(self._state, name)
        for robot in robots:
            plan += presence.robot_left(self._state, robot)
        self._rim.apply(plan)

    def _drop_later(self, seconds: float) -> None:
        """Robots that have no endpoint now have this long to appear at one."""
        robots = presence.stranded(self._state)
        if robots:
            self._rim.later(seconds, lambda: self._drop(robots))

    async def _drop(self, robots: list[Robot]) -> None:
        plan: Plan = []
        for robot in robots:
            if self._state.robots.get(robot.name) == robot:  # else it has come back, or even been stranded anew
                plan += presence.robot_left(self._state, robot.name)
        self._rim.apply(plan)
