"""Processes and robots come, go and come back: what is wanted is compared with what they say is there."""

from __future__ import annotations

from msgspec.structs import replace

from master.effects import Outcome, Plan, Send
from master.graph import remove_environment, remove_interfaces, start
from master.guests import made_by
from master.placement import place
from master.policies import UNLIMITED, Policy, check_robots
from master.records import Environment, Process, Robot, State, at, user_of
from master.wiring import RELAY, Ids, bring_up, connections_of, deactivate, link_spec, routes_of, take_down
from rce.calls.endpoints import Bind, Sync
from rce.calls.environments import KeepEnvironments, KnowRelays
from rce.calls.joining import Hello
from rce.calls.robots import DropRobot
from rce.errors import AlreadyExists, NoCapacity
from rce.names import check_robot


def joined(state: State, process: Process, hello: Hello, ids: Ids) -> Plan:
    """A process has connected: bring what it has in line with what is wanted."""
    plan: Plan = []
    before = state.processes.get(process.name)
    if before is not None and before.incarnation != process.incarnation:
        plan += take_down(state, process.name)
    relays = known_relays(state)
    state.processes.put(process)
    state.joined.add(process.name)
    state.expected.discard(process.name)
    if process.role == "container":
        plan += _machine_joined(state, process, hello, ids)
        return plan + resettle(state, ids) + _make_known(state, process, relays)
    if process.role == "service":  # it has nothing of the graph
        return plan
    if process.role == "robot":
        plan += _settle_robots(state, process, hello)
    owners = owners_at(state, process)
    # First what it shall have, then the routes that were waiting for it: their sequences begin with links.
    plan.append([Send(process.name, _sync(state, process, owners), "")])
    return plan + bring_up(state, owners, ids)


def owners_at(state: State, process: Process) -> list[str]:
    """The robots or the environment that this endpoint process has."""
    if process.role == "robot":
        return [robot.name for robot in state.robots.by(at(process.name))]
    return [process.name] if process.name in state.environments else []


def _sync(state: State, process: Process, owners: list[str]) -> Sync:
    interfaces = [interface for owner in owners for interface in state.interfaces.by(owner)]
    return Sync(
        interfaces=[interface.spec for interface in interfaces],
        links=[link_spec(state, link, process.name) for link in state.links.by(process.name)],
        routes=[route for interface in interfaces for route in routes_of(state, interface)],
        nodes=[node.spec for owner in owners for node in state.nodes.by(owner)],
        parameters=[parameter.spec for owner in owners for parameter in state.parameters.by(owner)],
        robots=owners if process.role == "robot" else [],
    )


def left(state: State, process: str) -> None:
    """A control connection is lost. Data goes on flowing: nothing is taken down until more is known."""
    state.joined.discard(process)
    if process in state.processes:
        state.expected.add(process)


# --- environments -----------------------------------------------------------------------------------------------------


def _machine_joined(state: State, process: Process, hello: Hello, ids: Ids) -> Plan:
    wanted = {environment.name: environment for environment in state.environments.by(at(process.name))}
    keep = [run for name, run in hello.environments.items() if name in wanted and wanted[name].run == run]
    plan: Plan = [[Send(process.name, KeepEnvironments(keep), "")]]
    for environment in wanted.values():
        if environment.run not in keep:
            plan += environment_down(state, environment)
            if environment.name in state.environments:
                plan += restart(state, environment, ids)
    return plan


def known_relays(state: State) -> list[str]:
    """The data relays of all machines, HOST:PORT."""
    return sorted(
        address.removeprefix(RELAY)
        for machine in state.processes.by("container")
        for address in machine.addresses
        if address.startswith(RELAY)
    )


def _make_known(state: State, process: Process, before: list[str]) -> Plan:
    """Tell a machine that has joined of the relays, and the others if there is a new one."""
    relays = known_relays(state)
    machines = [machine.name for machine in state.processes.by("container") if machine.name in state.joined]
    told = machines if relays != before else [process.name] if relays else []
    return [[Send(name, KnowRelays(relays), "relays")] for name in told]


def environment_down(state: State, environment: Environment) -> Plan:
    """An environment died: its connections are down until it is started again, or it goes if `restart` is `no`."""
    plan = take_down(state, environment.name)
    state.forget(environment.name)
    if environment.options.restart == "no":
        plan += remove_environment(state, environment)
    return plan


def restart(state: State, environment: Environment, ids: Ids) -> Plan:
    """A new life on the best machine; where there is none, it waits for one."""
    again = replace(environment, run=ids(), machine=_best_place(state, environment))
    state.environments.put(again)
    return start(state, again)


def _best_place(state: State, environment: Environment) -> str:
    """The best machine for an environment that does not run; an empty string if there is none now."""
    try:
        return place(state, user_of(environment.name), environment.options, environment.name)
    except NoCapacity:
        return ""


def lost_with(state: State, process: str) -> list[Environment]:
    """The environments that are lost now that nobody waits for `process`, a machine or an endpoint, any more.

    One whose endpoint is there lives: only its task set is gone. One whose machine is there is that machine's to judge.
    """
    own = state.environments.get(process)
    return [
        environment
        for environment in [*state.environments.by(at(process)), *([own] if own else [])]
        if state.gone(environment.machine) and state.gone(environment.name)
    ]


def resettle(state: State, ids: Ids) -> Plan:
    """New lives for the environments that wait for a machine or are lost with theirs, as far as others have room.

    What finds no room stays as it is: if its machine comes back before others have room, it may still run there.
    """
    plan: Plan = []
    gone = ["", *(machine.name for machine in state.processes.by("container") if state.gone(machine.name))]
    for environment in [environment for machine in gone for environment in state.environments.by(at(machine))]:
        runs_on = bool(environment.machine) and not state.gone(environment.name)
        if not runs_on and _best_place(state, environment):
            plan += restart(state, environment, ids)
    return plan


# --- robots -----------------------------------------------------------------------------------------------------------


def robot_arrived(
    state: State, robot: Robot, resume: str, ids: Ids, policy: Policy = UNLIMITED
) -> tuple[Outcome, bool]:
    """A robot's socket is at its endpoint; `resume` is the digest of the token that it presents.

    Returns what to do before the robot may go on, and whether it took its earlier session over.
    Raises AlreadyExists if the robotID is in use: by an environment, or by a session that was not resumed;
    LimitExceeded if the user has all the robots that `policy` allows.
    """
    name, (user, _, tag) = robot.name, robot.name.partition("/")
    check_robot(tag, "robotID")
    if name in state.environments:
        raise AlreadyExists(f"robotID {tag} is in use by an environment of yours", field="robotID")
    present = state.robots.get(name)
    if present is None:
        if robot.by.user == user:
            check_robots(state, user, policy)
        state.robots.put(robot)
        return Outcome([]), False
    if not resume or resume != present.session:
        raise AlreadyExists(
            f"robotID {tag} is in use: by another socket, or until its grace time ends; a session token resumes it",
            field="robotID",
        )
    socket_moved(state, name, True)
    moved = present.endpoint != robot.endpoint
    plan = _leave_endpoint(state, present) if moved else []
    state.robots.put(robot)
    if moved:
        bound = [each.spec for each in state.interfaces.by(name)]
        plan += [[Send(robot.endpoint, Bind(spec), spec.id)] for spec in bound]
        plan += bring_up(state, [name], ids)
    return Outcome(plan), True


def _leave_endpoint(state: State, robot: Robot) -> Plan:
    plan: Plan = []
    for connection in connections_of(state, robot.name):
        plan += deactivate(state, connection)
    if robot.endpoint in state.joined:
        plan.append([Send(robot.endpoint, DropRobot(robot.name, "resumed elsewhere"), robot.name)])
    return plan


def robot_left(state: State, name: str) -> Plan:
    """A robot's grace time is over: its interfaces and connections go, with a guest all that it made; its user's
    environments stay.
    """
    if name not in state.robots:
        return []
    plan = remove_interfaces(state, name) + made_by(state, name)
    state.away.discard(name)
    state.robots.drop(name)
    return plan


def robot_dismissed(state: State, name: str, reason: str) -> Plan:
    """A robot's session ends now: its socket is closed with the reason."""
    robot = state.robots.get(name)
    plan = robot_left(state, name)
    if robot is not None and robot.endpoint in state.joined:
        plan.append([Send(robot.endpoint, DropRobot(name, reason), name)])
    return plan


def user_gone(state: State, user: str) -> Plan:
    """Take all that a user has out of the graph."""
    plan: Plan = []
    for robot in state.robots.by(user):
        plan += robot_dismissed(state, robot.name, "the user was removed")
    for environment in state.environments.by(user):
        plan += remove_environment(state, environment)
    for package in state.packages.by(user):
        state.packages.drop(package.key)
    for package in state.packages.by(f">{user}"):  # a namesake to come is somebody else
        state.packages.put(replace(package, shared=[each for each in package.shared if each != user]))
    return plan


def endpoint_gone(state: State, process: str) -> tuple[Plan, list[str]]:
    """A Robot endpoint does not come back: its robots have the grace time to appear elsewhere. Returns their names."""
    plan = take_down(state, process)
    stranded = [robot.name for robot in state.robots.by(at(process))]
    for name in stranded:
        state.robots.put(replace(state.robots[name], endpoint=""))
    state.processes.drop(process)
    return plan, stranded


def _settle_robots(state: State, process: Process, hello: Hello) -> Plan:
    """Robots that this endpoint should have but has not are stranded; those it has but should not are dropped."""
    present = set(hello.robots)
    plan: Plan = []
    for robot in state.robots.by(at(process.name)):
        socket_moved(state, robot.name, robot.name not in hello.away)
        if robot.name not in present:
            for connection in connections_of(state, robot.name):
                plan += deactivate(state, connection)
            state.robots.put(replace(robot, endpoint=""))
    return plan


def socket_moved(state: State, robot: str, connected: bool) -> None:
    """A robot's socket is open, or lost."""
    if connected:
        state.away.discard(robot)
    else:
        state.away.add(robot)


def stranded(state: State) -> list[Robot]:
    """Robots without an endpoint: their grace time runs."""
    return state.robots.by(at(""))
