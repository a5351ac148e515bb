"""Random commands, losses and returns: the graph keeps its invariants, and the processes end up as it wants them."""

from __future__ import annotations

import ipaddress
import itertools
import random
from typing import Any

from fleet import Fleet, everything, interface
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from simulated import Delivery, Endpoint, TaskSet

from master import presence, wiring
from master.effects import Send
from master.graph import OPPOSITE, split_kind
from master.records import at, user_of
from rce import messages as m
from rce.errors import RceError
from rce.names import parse_type

WEST_EAST = ("west", "east")
MACHINES = {"m1": 2, "m2": 3}
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
    st.builds(m.Connect, sides, sides),
    st.builds(m.Disconnect, sides, sides),
)
seeds = st.integers(0, 2**16)


class Platform(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.fleet = Fleet()
        self.numbers = itertools.count(1)
        self.state = self.fleet.state
        self.connected: dict[str, int] = {}  # number of its connection by process
        self.delivery = Delivery(self.connected)
        self.endpoints = {name: Endpoint(name, self.fleet.ids()) for name in WEST_EAST}
        self.task_sets = {name: TaskSet(name, self._killed) for name in MACHINES}
        self.down: dict[str, str] = {}  # environments that died and are to be restarted: their run
        self.tokens: dict[str, str] = {}  # of robots whose login is complete
        self.logins: list[tuple[list[Any], str, str, str]] = []
        self._connect("west")
        self._connect("m1")
        self._furnish()

    def _furnish(self) -> None:
        """Ann has a robot connected with an environment: what all that follows may break."""
        self._login("ann/r1", "west", "")
        self._drain()
        for command in (
            m.CreateContainer("e1"),
            interface("r1", "a", "PublisherConverter"),
            interface("e1", "a", "SubscriberInterface"),
            m.Connect("e1/a", "r1/a"),
        ):
            self.delivery.add(self.fleet.do("ann", command).plan)
        self._drain()

    # --- the rim: what the Master's service does, without waiting -------------------------------------------------

    def _carry(self, send: Send) -> None:
        taker = self.task_sets.get(send.to) or self.endpoints.get(send.to)
        assert taker is not None
        taker.take(send.call)
        taker.take(send.call)

    def _step(self, chosen: random.Random) -> bool:
        ready = self.delivery.runnable()
        if not ready:
            assert not self.delivery.sequences, "what is under way waits for itself"
            return False
        self.delivery.run(chosen.choice(ready), self._carry)
        self._answer_logins()
        self._start_environments()
        return True

    def _drain(self, seed: int = 0) -> None:
        chosen = random.Random(seed)
        while self._step(chosen):
            pass

    def _start_environments(self) -> None:
        """A started environment's endpoint process appears; it joins in a step of its own.

        That of an earlier life, which may still run on a machine out of sight, can join no more: it plays no part.
        """
        for task_set in self.task_sets.values():
            for name, run in task_set.runs.items():
                present, wanted = self.endpoints.get(name), self.state.environments.get(name)
                if present is None or (present.incarnation != run and wanted is not None and wanted.run == run):
                    if present is not None:
                        self._killed(name, present.incarnation)
                    self.endpoints[name] = Endpoint(name, run)

    def _killed(self, name: str, run: str) -> None:
        present = self.endpoints.get(name)
        if present is not None and present.incarnation == run:
            del self.endpoints[name]
            if name in self.connected:
                self._lose(name)

    def _lose(self, name: str) -> None:
        self.connected.pop(name, None)
        presence.left(self.state, name)

    def _connect(self, name: str) -> None:
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

    def _may_join(self, name: str) -> bool:
        if name in self.connected:
            return False
        if name in self.task_sets or name in WEST_EAST:
            return True
        environment = self.state.environments.get(name)
        return environment is not None and self.endpoints[name].incarnation == environment.run

    def _login(self, name: str, endpoint: str, resume: str) -> None:
        session = self.fleet.ids()
        outcome, _ = self.fleet.robot(name, endpoint, session, resume)
        self.tokens.pop(name, None)
        self.logins.append((self.delivery.add(outcome.plan), name, endpoint, session))
        self._answer_logins()

    def _answer_logins(self) -> None:
        """A login is answered when its plan is carried out, and after the Sync of that endpoint."""
        for login in list(self.logins):
            steps, name, endpoint, session = login
            syncing = any(step.send.to == endpoint and not step.send.key for s in self.delivery.sequences for step in s)
            if syncing or not all(step.done for step in steps):
                continue
            self.logins.remove(login)
            robot = self.state.robots.get(name)
            if robot is not None and (robot.endpoint, robot.session) == (endpoint, session):
                self.endpoints[endpoint].robots.add(name)
                self.tokens[name] = session

    # --- what happens ---------------------------------------------------------------------------------------------

    @rule(user=users, command=commands, again=st.booleans())
    def command(self, user: str, command: m.Command, again: bool) -> None:
        before = everything(self.state)
        others = {key: record for key, record in before.items() if self._owner(key) not in (user, "")}
        try:
            plan = self.fleet.do(user, command, again).plan
        except RceError:
            assert everything(self.state) == before
            return
        after = everything(self.state)
        assert {key: record for key, record in after.items() if self._owner(key) not in (user, "")} == others
        self.delivery.add(plan)

    @staticmethod
    def _owner(key: str) -> str:
        kind, _, rest = key.partition(" ")
        return "" if kind in ("Process", "Link") else user_of(rest)

    @rule(seed=seeds, count=st.integers(1, 12))
    def some_calls_are_made(self, seed: int, count: int) -> None:
        chosen = random.Random(seed)
        for _ in range(count):
            self._step(chosen)

    @rule(data=st.data())
    def a_process_joins(self, data: st.DataObject) -> None:
        absent = sorted(name for name in [*self.task_sets, *self.endpoints] if self._may_join(name))
        if absent:
            self._connect(data.draw(st.sampled_from(absent)))

    @precondition(lambda self: self.connected)
    @rule(data=st.data())
    def a_control_connection_is_lost(self, data: st.DataObject) -> None:
        self._lose(data.draw(st.sampled_from(sorted(self.connected))))

    @rule(name=st.sampled_from(WEST_EAST))
    def a_robot_endpoint_dies(self, name: str) -> None:
        self._lose(name)
        self.endpoints[name] = Endpoint(name, self.fleet.ids())

    @rule(name=st.sampled_from(WEST_EAST))
    def a_robot_endpoint_stays_away(self, name: str) -> None:
        if name not in self.connected:
            plan, stranded = presence.endpoint_gone(self.state, name)
            for robot in stranded:
                plan += presence.robot_left(self.state, robot)
            self.delivery.add(plan)

    @rule(data=st.data())
    def an_environment_dies(self, data: st.DataObject) -> None:
        running = [(name, t) for t in self.task_sets.values() for name in sorted(t.runs)]
        if not running:
            return
        name, task_set = data.draw(st.sampled_from(running))
        run = task_set.runs.pop(name)
        self._killed(name, run)
        environment = self.state.environments.get(name)
        if task_set.name in self.connected and environment is not None and environment.run == run:
            self.delivery.add(presence.environment_down(self.state, environment))
            if name in self.state.environments:
                self.down[name] = run

    @rule(name=st.sampled_from(sorted(MACHINES)))
    def a_machine_stays_away(self, name: str) -> None:
        """It is cut off: what is on it may run on, out of sight."""
        if name in self.connected:
            self._lose(name)
        for environment in self.state.environments.by(at(name)):
            if environment.name in self.connected:
                self._lose(environment.name)
            self.state.expected.discard(environment.name)
        self.state.expected.discard(name)
        for environment in presence.lost_with(self.state, name):
            self.delivery.add(presence.environment_down(self.state, environment))
        self.delivery.add(presence.resettle(self.state, self.fleet.ids))

    @rule()
    def dead_environments_are_restarted(self) -> None:
        for name, run in self.down.items():
            environment = self.state.environments.get(name)
            if environment is not None and environment.run == run:
                self.delivery.add(presence.restart(self.state, environment, self.fleet.ids))
        self.down.clear()

    @rule(user=users, tag=robots, endpoint=st.sampled_from(WEST_EAST), resume=st.booleans())
    def a_robot_arrives(self, user: str, tag: str, endpoint: str, resume: bool) -> None:
        name = f"{user}/{tag}"
        if endpoint not in self.connected:
            return
        before = everything(self.state)
        try:
            self._login(name, endpoint, self.tokens.get(name, "") if resume else "")
        except RceError:
            assert name in self.state.robots
            assert everything(self.state) == before

    @rule(user=users, tag=robots)
    def a_robot_leaves(self, user: str, tag: str) -> None:
        robot = self.state.robots.get(f"{user}/{tag}")
        if robot is not None and robot.endpoint in self.connected:
            self.endpoints[robot.endpoint].robots.discard(robot.name)
            self.delivery.add(presence.robot_left(self.state, robot.name))

    @rule()
    def stranded_robots_are_given_up(self) -> None:
        for robot in presence.stranded(self.state):
            self.delivery.add(presence.robot_left(self.state, robot.name))

    @rule(data=st.data())
    def a_link_is_lost(self, data: st.DataObject) -> None:
        names = sorted(link.name for link in self.state.links)
        if names:
            self.delivery.add(wiring.reopen(self.state, data.draw(st.sampled_from(names)), self.fleet.ids))

    @rule(seed=seeds)
    def all_comes_to_rest(self, seed: int) -> None:
        self._drain(seed)
        self._check_convergence()

    @rule(seed=seeds)
    def all_come_back(self, seed: int) -> None:
        """After this nothing may be missing: every connection of two that are there is up."""
        self.dead_environments_are_restarted()
        for _ in range(3):  # task sets start environments, which join
            for name in sorted([*self.task_sets, *self.endpoints]):
                if (name in self.endpoints or name in self.task_sets) and self._may_join(name):
                    self._connect(name)
            self._drain(seed)
        self._check_convergence()
        for environment in self.state.environments:
            assert environment.name in self.state.joined or not environment.machine
        assert presence.resettle(self.state, self.fleet.ids) == []

    # --- what always holds ----------------------------------------------------------------------------------------

    @invariant()
    def names_and_owners(self) -> None:
        state = self.state
        assert not {robot.name for robot in state.robots} & {environment.name for environment in state.environments}
        for inside in (*state.nodes, *state.parameters):
            assert inside.owner in state.environments
        for record in state.interfaces:
            home = state.environments if split_kind(record.spec.kind)[1] == "Interface" else state.robots
            assert record.spec.owner in home
        assert len({record.spec.id for record in state.interfaces}) == len(state.interfaces)

    @invariant()
    def connections_are_pairs(self) -> None:
        state = self.state
        providers = set()
        for connection in state.connections:
            sender, receiver = state.interfaces[connection.sender].spec, state.interfaces[connection.receiver].spec
            assert user_of(sender.owner) == user_of(receiver.owner)
            assert parse_type(sender.type) == parse_type(receiver.type)
            (sends, _), (receives, _) = split_kind(sender.kind), split_kind(receiver.kind)
            assert sends in ("Subscriber", "ServiceProvider")
            assert OPPOSITE[receives] == sends
            if sends == "ServiceProvider":
                assert connection.sender not in providers
                providers.add(connection.sender)

    @invariant()
    def a_connection_is_up_if_both_sides_are_there(self) -> None:
        """It stays up while the Master has lost sight of a side, because data flows on."""
        state = self.state
        for connection in state.connections:
            owners = [state.interfaces[side].spec.owner for side in (connection.sender, connection.receiver)]
            if all(state.host(owner) for owner in owners):
                assert connection.link
            if connection.link:
                link = state.links[connection.link]
                hosts = [state.robots[owner].endpoint if owner in state.robots else owner for owner in owners]
                assert {link.listener, link.dialler} == set(hosts)
                ends = (link.listener, link.dialler)
                assert link.incarnations == tuple(state.processes[end].incarnation for end in ends)
                assert link.alone_for in ("", connection.key)

    @invariant()
    def links_are_used_and_shared(self) -> None:
        seen = set()
        for link in self.state.links:
            assert self.state.connections.by(link.name)
            assert (link.key_hex == "") == (link.listener == link.dialler)
            purpose = (frozenset((link.listener, link.dialler)), link.alone_for)
            assert purpose not in seen
            seen.add(purpose)

    @invariant()
    def machines_are_not_overfull(self) -> None:
        state = self.state
        for machine in state.processes.by("container"):
            assert sum(each.options.size for each in state.environments.by(at(machine.name))) <= machine.capacity

    @invariant()
    def groups_have_distinct_addresses(self) -> None:
        given = [
            (user_of(each.name), each.options.group, ipaddress.ip_address(each.address))
            for each in self.state.environments
            if each.options.group
        ]
        assert len(given) == len(set(given))

    @invariant()
    def who_has_joined_is_known(self) -> None:
        assert self.state.joined <= {process.name for process in self.state.processes}
        for process in self.state.processes.by("environment"):
            assert process.name in self.state.environments

    # --- what shall be at the processes ---------------------------------------------------------------------------

    def _check_convergence(self) -> None:
        for name in sorted(self.connected):
            if name in self.task_sets:
                wanted = {
                    each.name: each.run
                    for each in self.state.environments.by(at(name))
                    if self.down.get(each.name) != each.run
                }
                assert self.task_sets[name].runs == wanted
            elif name in self.state.joined:
                self._check_endpoint(self.endpoints[name])

    def _check_endpoint(self, endpoint: Endpoint) -> None:
        state = self.state
        process = state.processes[endpoint.name]
        owners = presence.owners_at(state, process)
        interfaces = [each for owner in owners for each in state.interfaces.by(owner)]
        routes = [route for each in interfaces for route in wiring.routes_of(state, each)]
        assert endpoint.interfaces == {each.spec.id: each.spec for each in interfaces}
        assert endpoint.links == {link.name for link in state.links.by(endpoint.name)}
        assert endpoint.routes == {(route.interface, route.peer): route.link for route in routes}
        assert endpoint.nodes == {each.spec.tag: each.spec for owner in owners for each in state.nodes.by(owner)}
        parameters = {each.spec.key: each.spec for owner in owners for each in state.parameters.by(owner)}
        assert endpoint.parameters == parameters
        if process.role == "robot":
            assert endpoint.robots == set(owners)


Platform.TestCase.settings = settings(
    max_examples=200,
    stateful_step_count=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
TestPlatform = Platform.TestCase
