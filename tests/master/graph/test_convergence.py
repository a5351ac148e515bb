"""Random commands, losses and returns: invariants hold, and the processes converge to the records."""

from __future__ import annotations

import random

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from master.graph import reconcile, sessions, wiring
from master.graph.records import Ref, user_of
from master.graph.state import at
from rce.errors import RceError
from rce.protocol import messages as m
from tests.support.master import invariants
from tests.support.master.fleet import everything, interface
from tests.support.master.simulated import Endpoint
from tests.support.master.simulated_runner import MACHINES, WEST_EAST, EffectRunner

users = st.sampled_from(["ann", "bob"])
robots = st.sampled_from(["r1", "r2"])
environments = st.sampled_from(["e1", "e2"])
owners = robots | environments
tags = st.sampled_from(["a", "b"])
sides = st.builds("{}/{}".format, owners, tags)
kinds = st.builds(
    "{}{}".format,
    st.sampled_from(["Publisher", "Subscriber", "ServiceClient", "ServiceProvider"]),
    st.sampled_from(["Converter", "Interface"]),
)
options = st.builds(
    m.ContainerData,
    size=st.sampled_from([1, 1, 2]),
    group=st.sampled_from(["", "g"]),
    restart=st.sampled_from(["always", "always", "no"]),
)
commands = st.one_of(
    st.builds(m.CreateContainer, environments, options),
    st.builds(m.DestroyContainer, environments),
    st.builds(m.AddNode, environments, tags, st.just("p"), st.just("e")),
    st.builds(m.RemoveNode, environments, tags),
    st.builds(interface, owners, tags, kinds, qos=st.sampled_from([m.Qos(), m.Qos(history="keep_all")])),
    st.builds(m.RemoveInterface, owners, tags),
    st.builds(m.SetParameter, environments, tags, st.integers(0, 2)),
    st.builds(m.DeleteParameter, environments, tags),
    st.builds(m.AddRecorder, environments, tags, existOk=st.booleans()),
    st.builds(m.RemoveRecorder, environments, tags),
    st.builds(m.Connect, sides, sides),
    st.builds(m.Disconnect, sides, sides),
)
seeds = st.integers(0, 2**16)


class Platform(EffectRunner, RuleBasedStateMachine):
    def __init__(self) -> None:
        RuleBasedStateMachine.__init__(self)
        EffectRunner.__init__(self)
        self.connect("west")
        self.connect("m1")
        self._furnish()

    def _furnish(self) -> None:
        """Connect a robot of ann with an environment, as something to break."""
        self.login("ann/r1", "west", "")
        self.drain()
        for command in (
            m.CreateContainer("e1"),
            interface("r1", "a", "PublisherConverter"),
            interface("e1", "a", "SubscriberInterface"),
            m.Connect("e1/a", "r1/a"),
        ):
            self.delivery.add(self.fleet.do("ann", command).plan)
        self.drain()

    # --- what happens ---------------------------------------------------------------------------------------------

    @rule(user=users, command=commands, again=st.booleans(), robot=st.just("") | robots)
    def command(self, user: str, command: m.Command, again: bool, robot: str) -> None:
        before = everything(self.state)
        others = {key: record for key, record in before.items() if self._owner(key) not in (user, "")}
        try:
            outcome = self.fleet.do(user, command, again, robot)
        except RceError:
            assert everything(self.state) == before
            return
        after = everything(self.state)
        assert {key: record for key, record in after.items() if self._owner(key) not in (user, "")} == others
        self.delivery.add(outcome.plan + outcome.follows)

    @staticmethod
    def _owner(ref: Ref) -> str:
        return "" if ref.kind in ("process", "link") else user_of(ref.key)

    @rule(seed=seeds, count=st.integers(1, 12))
    def some_calls_are_made(self, seed: int, count: int) -> None:
        chosen = random.Random(seed)
        for _ in range(count):
            self.step(chosen)

    @rule(data=st.data())
    def a_process_joins(self, data: st.DataObject) -> None:
        absent = sorted(name for name in [*self.task_sets, *self.endpoints] if self.may_join(name))
        if absent:
            self.connect(data.draw(st.sampled_from(absent)))

    @precondition(lambda self: self.connected)
    @rule(data=st.data())
    def a_control_connection_is_lost(self, data: st.DataObject) -> None:
        self.lose(data.draw(st.sampled_from(sorted(self.connected))))

    @rule(name=st.sampled_from(WEST_EAST))
    def a_robot_endpoint_dies(self, name: str) -> None:
        self.lose(name)
        self.endpoints[name] = Endpoint(name, self.fleet.ids())

    @rule(name=st.sampled_from(WEST_EAST))
    def a_robot_endpoint_stays_away(self, name: str) -> None:
        if name not in self.connected:
            plan, stranded = sessions.endpoint_gone(self.state, name)
            for robot in stranded:
                plan += sessions.robot_left(self.state, robot)
            self.delivery.add(plan)

    @rule(data=st.data())
    def an_environment_dies(self, data: st.DataObject) -> None:
        running = [(name, t) for t in self.task_sets.values() for name in sorted(t.runs)]
        if not running:
            return
        name, task_set = data.draw(st.sampled_from(running))
        run = task_set.runs.pop(name)
        self.killed(name, run)
        environment = self.state.environments.get(name)
        if task_set.name in self.connected and environment is not None and environment.run == run:
            self.delivery.add(reconcile.environment_down(self.state, environment))
            if name in self.state.environments:
                self.down[name] = run

    @rule(name=st.sampled_from(sorted(MACHINES)))
    def a_machine_stays_away(self, name: str) -> None:
        """Cut off a machine: what runs on it goes on unseen."""
        if name in self.connected:
            self.lose(name)
        for environment in self.state.environments.by(at(name)):
            if environment.name in self.connected:
                self.lose(environment.name)
            self.state.expected.discard(environment.name)
        self.state.expected.discard(name)
        for environment in reconcile.lost_with(self.state, name):
            self.delivery.add(reconcile.environment_down(self.state, environment))
        self.delivery.add(reconcile.resettle(self.state, self.fleet.ids))

    @rule()
    def dead_environments_are_restarted(self) -> None:
        for name, run in self.down.items():
            environment = self.state.environments.get(name)
            if environment is not None and environment.run == run:
                self.delivery.add(reconcile.restart(self.state, environment, self.fleet.ids))
        self.down.clear()

    @rule(user=users, tag=robots, endpoint=st.sampled_from(WEST_EAST), resume=st.booleans())
    def a_robot_arrives(self, user: str, tag: str, endpoint: str, resume: bool) -> None:
        name = f"{user}/{tag}"
        if endpoint not in self.connected:
            return
        before = everything(self.state)
        try:
            self.login(name, endpoint, self.tokens.get(name, "") if resume else "")
        except RceError:
            assert name in self.state.robots
            assert everything(self.state) == before

    @rule(user=users, tag=robots)
    def a_robot_leaves(self, user: str, tag: str) -> None:
        robot = self.state.robots.get(f"{user}/{tag}")
        if robot is not None and robot.endpoint in self.connected:
            self.endpoints[robot.endpoint].robots.discard(robot.name)
            self.delivery.add(sessions.robot_left(self.state, robot.name))

    @rule()
    def stranded_robots_are_given_up(self) -> None:
        for robot in sessions.stranded(self.state):
            self.delivery.add(sessions.robot_left(self.state, robot.name))

    @rule(data=st.data())
    def a_link_is_lost(self, data: st.DataObject) -> None:
        names = sorted(link.name for link in self.state.links)
        if names:
            self.delivery.add(wiring.reopen(self.state, data.draw(st.sampled_from(names)), self.fleet.ids))

    @rule(seed=seeds)
    def all_comes_to_rest(self, seed: int) -> None:
        self.drain(seed)
        self.check_convergence()

    @rule(seed=seeds)
    def all_come_back(self, seed: int) -> None:
        """Reconnect everything; then every connection with two present sides must be up."""
        self.dead_environments_are_restarted()
        for _ in range(3):  # task sets start environments, which join
            for name in sorted([*self.task_sets, *self.endpoints]):
                if (name in self.endpoints or name in self.task_sets) and self.may_join(name):
                    self.connect(name)
            self.drain(seed)
        self.check_convergence()
        for environment in self.state.environments:
            assert environment.name in self.state.joined or not environment.machine
        assert reconcile.resettle(self.state, self.fleet.ids) == []

    # --- what always holds ----------------------------------------------------------------------------------------

    @invariant()
    def the_invariants(self) -> None:
        invariants.check(self.state)


Platform.TestCase.settings = settings(
    max_examples=200,
    stateful_step_count=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
TestPlatform = pytest.mark.slow(Platform.TestCase)
