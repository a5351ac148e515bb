"""Effect runner in memory: plans run call by call, in any order that the dispatcher allows."""

from __future__ import annotations

import itertools
import random
from typing import Any

from master.graph import reconcile, wiring
from master.graph.effects import Send
from master.graph.records import Ref
from master.graph.state import at
from master.graph.translation import interface_spec, node_spec, parameter_spec
from tests.support.master.fleet import Fleet
from tests.support.master.simulated import Delivery, Endpoint, TaskSet

WEST_EAST = ("west", "east")
MACHINES = {"m1": 2, "m2": 3}


class EffectRunner:
    """Effect runner for processes in memory, without waiting."""

    def __init__(self) -> None:
        self.fleet = Fleet()
        self.numbers = itertools.count(1)
        self.state = self.fleet.state
        self.connected: dict[str, int] = {}  # number of the connection by process
        self.delivery = Delivery(self.connected)
        self.endpoints = {name: Endpoint(name, self.fleet.ids()) for name in WEST_EAST}
        self.task_sets = {name: TaskSet(name, self.killed) for name in MACHINES}
        self.down: dict[str, str] = {}  # runs of environments that died and wait for their restart
        self.tokens: dict[str, str] = {}  # of robots that are logged in
        self.logins: list[tuple[list[Any], str, str, str]] = []

    def carry(self, send: Send) -> None:
        taker = self.task_sets.get(send.to) or self.endpoints.get(send.to)
        assert taker is not None
        taker.take(send.call)
        taker.take(send.call)

    def step(self, chosen: random.Random) -> bool:
        ready = self.delivery.runnable()
        if not ready:
            assert not self.delivery.sequences, "what is under way waits for itself"
            return False
        self.delivery.run(chosen.choice(ready), self.carry)
        self.answer_logins()
        self.start_environments()
        return True

    def drain(self, seed: int = 0) -> None:
        chosen = random.Random(seed)
        while self.step(chosen):
            pass

    def start_environments(self) -> None:
        """Make endpoint processes of started environments; they join in steps of their own.

        The process of an earlier life may still run on a machine that is cut off, but it cannot join any more.
        """
        for task_set in self.task_sets.values():
            for name, run in task_set.runs.items():
                present, wanted = self.endpoints.get(name), self.state.environments.get(name)
                if present is None or (present.incarnation != run and wanted is not None and wanted.run == run):
                    if present is not None:
                        self.killed(name, present.incarnation)
                    self.endpoints[name] = Endpoint(name, run)

    def killed(self, name: str, run: str) -> None:
        present = self.endpoints.get(name)
        if present is not None and present.incarnation == run:
            del self.endpoints[name]
            if name in self.connected:
                self.lose(name)

    def lose(self, name: str) -> None:
        self.connected.pop(name, None)
        reconcile.left(self.state, name)

    def connect(self, name: str) -> None:
        self.connected[name] = next(self.numbers)
        if name in self.task_sets:
            plan = self.fleet.join(
                name, "container", "1", capacity=MACHINES[name], environments=dict(self.task_sets[name].runs)
            )
        elif name in WEST_EAST:
            endpoint = self.endpoints[name]
            plan = self.fleet.join(name, "robot", endpoint.incarnation, robots=sorted(endpoint.robots))
        else:
            plan = self.fleet.join(name, "environment", self.endpoints[name].incarnation)
        self.delivery.add(plan)

    def may_join(self, name: str) -> bool:
        if name in self.connected:
            return False
        if name in self.task_sets or name in WEST_EAST:
            return True
        environment = self.state.environments.get(name)
        return environment is not None and self.endpoints[name].incarnation == environment.run

    def login(self, name: str, endpoint: str, resume: str) -> None:
        session = self.fleet.ids()
        outcome, _ = self.fleet.robot(name, endpoint, session, resume)
        self.tokens.pop(name, None)
        self.logins.append((self.delivery.add(outcome.plan), name, endpoint, session))
        self.answer_logins()

    def answer_logins(self) -> None:
        """Answer logins at endpoints in sync whose plans, and earlier calls about the robot, are complete."""
        for login in list(self.logins):
            steps, name, endpoint, session = login
            waiting = any(self._is_under_way(endpoint, about) for about in (None, Ref("robot", name)))
            if waiting or not all(step.done for step in steps):
                continue
            self.logins.remove(login)
            robot = self.state.robots.get(name)
            if robot is not None and (robot.endpoint, robot.session) == (endpoint, session):
                self.endpoints[endpoint].robots.add(name)
                self.tokens[name] = session

    def _is_under_way(self, process: str, about: Ref | None) -> bool:
        return any(
            (step.send.to, step.send.about) == (process, about) for steps in self.delivery.sequences for step in steps
        )

    def check_convergence(self) -> None:
        """Check that the processes have exactly what the records want."""
        for name in sorted(self.connected):
            if name in self.task_sets:
                wanted = {
                    each.name: each.run
                    for each in self.state.environments.by(at(name))
                    if self.down.get(each.name) != each.run
                }
                assert self.task_sets[name].runs == wanted
            elif name in self.state.joined:
                self.check_endpoint(self.endpoints[name])

    def check_endpoint(self, endpoint: Endpoint) -> None:
        state = self.state
        process = state.processes[endpoint.name]
        owners = reconcile.owners_at(state, process)
        interfaces = [each for owner in owners for each in state.interfaces.by(owner)]
        routes = [route for each in interfaces for route in wiring.routes_of(state, each)]
        assert endpoint.interfaces == {each.id: interface_spec(each) for each in interfaces}
        assert endpoint.links == {link.name for link in state.links.by(endpoint.name)}
        assert endpoint.routes == {(route.interface, route.peer): route.link for route in routes}
        assert endpoint.nodes == {each.tag: node_spec(each) for owner in owners for each in state.nodes.by(owner)}
        parameters = {
            spec.key: spec for owner in owners for each in state.parameters.by(owner) for spec in [parameter_spec(each)]
        }
        assert endpoint.parameters == parameters
        if process.role == "robot":
            assert endpoint.robots == set(owners)
