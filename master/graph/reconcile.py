"""Reconciliation: processes and robots join, leave and return, and are brought in line with the records."""

from __future__ import annotations

import math

from msgspec.structs import replace

from master.graph import catalogue
from master.graph.changes import (
    end_use,
    remove_environment,
    remove_interface,
    remove_interfaces,
    remove_node,
    start,
)
from master.graph.connections import drop_waiting
from master.graph.effects import MarkReady, Outcome, Plan, Send
from master.graph.limits import UNLIMITED, Policy, check_robots
from master.graph.placement import most_free_slots, place
from master.graph.records import Environment, Process, Ref, Robot, ref, user_of
from master.graph.state import State, all_of, at
from master.graph.translation import interface_spec, node_spec, parameter_spec, recorder_spec
from master.graph.wiring import (
    Ids,
    bring_up,
    connections_of,
    deactivate,
    interface_ref,
    link_spec,
    routes_of,
    take_down,
)
from rce.control.calls.endpoints import Bind, PutSecrets, Secret, Sync
from rce.control.calls.environments import KeepEnvironments, SetRelays
from rce.control.calls.joining import Hello, SetRemovedMachines
from rce.control.calls.robots import DropRobot
from rce.errors import AlreadyExists, NoCapacity, Unavailable
from rce.protocol.names import check_robot_id, is_guest


def process_of(state: State, hello: Hello) -> Process:
    """Return the record of a process that joins.

    Programs in an environment may send the Hello of their endpoint, so nothing in it decides what others dial.

    Raises:
        Unavailable: The task set has not told yet how the host of an environment is reached.
    """
    environment = state.environments.get(hello.name) if hello.role == "environment" else None
    if environment is not None:
        return Process(environment.name, "environment", environment.run, _host_of(state, environment, hello.host))
    return Process(
        hello.name,
        hello.role,  # type: ignore[arg-type]  # admitted: so it is one of the roles
        hello.incarnation,
        hello.host,
        hello.addresses,
        hello.url,
        hello.capacity,
        hello.features,
        hello.gpus,
        hello.sockets,
        hello.relays,
        hello.not_enforced,
    )


def _host_of(state: State, environment: Environment, told: str) -> str:
    """Return the host of an environment; it tells which, if its task set has several."""
    machine = state.processes.get(environment.machine)
    if machine is None or machine.host or not machine.relays:
        return machine.host if machine else ""
    if told not in machine.relays:
        raise Unavailable(f"{machine.name} has not told yet how the host of {environment.name} is reached")
    return told


def joined(state: State, process: Process, hello: Hello, ids: Ids) -> Plan:
    """Add a process that has connected, and bring what it has in line with the records."""
    plan: Plan = []
    before = state.processes.get(process.name)
    if before is not None and before.incarnation != process.incarnation:
        plan += take_down(state, process.name)
    relays = known_relays(state) if process.role == "container" else []
    state.processes.put(process)
    state.joined.add(process.name)
    state.expected.discard(process.name)
    if state.removed_machines and process.role in ("robot", "container"):  # those that accept data links
        plan.append([_removed_machines(state, process.name)])
    if process.role == "container":
        plan += _machine_joined(state, process, hello, ids)
        return plan + resettle(state, ids) + _announce_relays(state, process, relays)
    if process.role == "service":  # services have no part in the graph
        return plan
    if process.role == "robot":
        plan += _settle_robots(state, process, hello)
    owners = owners_at(state, process)
    # Its Sync goes first; the sequences of connections that waited for it begin with links.
    plan.append([*_secrets(state, process), Send(process.name, _sync(state, process, owners), None)])
    return plan + bring_up(state, owners, ids)


def _secrets(state: State, process: Process) -> list[Send | MarkReady]:
    """Return the call that gives an environment its secrets before it has nodes; values are added when it leaves."""
    environment = state.environments.get(process.name)
    if environment is None or not environment.options.secrets:
        return []
    wanted = {name: Secret(variable) for name, variable in environment.options.secrets.items()}
    return [Send(process.name, PutSecrets(wanted), None)]


def announce_removals(state: State) -> Plan:
    """Tell all connected processes that accept data links which machines were removed."""
    processes = [*state.processes.by("robot"), *state.processes.by("container")]
    return [[_removed_machines(state, each.name)] for each in processes if each.name in state.joined]


def _removed_machines(state: State, process: str) -> Send:
    return Send(process, SetRemovedMachines(state.removed_machines), Ref("removed", ""))


def machine_removed(state: State, name: str) -> None:
    """Forget a task set that was removed; the environments that it had wait for another machine."""
    for environment in state.environments.by(at(name)):
        state.environments.put(replace(environment, machine=""))
    state.forget(name)


def owners_at(state: State, process: Process) -> list[str]:
    """Return the robots or the environment of an endpoint process."""
    if process.role == "robot":
        return [robot.name for robot in state.robots.by(at(process.name))]
    return [process.name] if process.name in state.environments else []


def _sync(state: State, process: Process, owners: list[str]) -> Sync:
    interfaces = [interface for owner in owners for interface in state.interfaces.by(owner)]
    return Sync(
        interfaces=[interface_spec(interface) for interface in interfaces],
        links=[link_spec(state, link, process.name) for link in state.links.by(process.name)],
        routes=[route for interface in interfaces for route in routes_of(state, interface)],
        nodes=[node_spec(node) for owner in owners for node in state.nodes.by(owner) if not node.part_of],
        parameters=[parameter_spec(parameter) for owner in owners for parameter in state.parameters.by(owner)],
        recorders=[recorder_spec(recorder) for owner in owners for recorder in state.recorders.by(owner)],
        robots=owners if process.role == "robot" else [],
    )


def left(state: State, process: str) -> None:
    """Note that a control connection is lost. Data flows on, so nothing is taken down during the grace period."""
    state.joined.discard(process)
    if process in state.processes:
        state.expected.add(process)


# --- environments -----------------------------------------------------------------------------------------------------


def _machine_joined(state: State, process: Process, hello: Hello, ids: Ids) -> Plan:
    wanted = {environment.name: environment for environment in state.environments.by(at(process.name))}
    keep = [run for name, run in hello.environments.items() if name in wanted and wanted[name].run == run]
    plan: Plan = [[Send(process.name, KeepEnvironments(keep), None)]]
    for environment in wanted.values():
        if environment.run not in keep:
            plan += environment_down(state, environment)
            if environment.name in state.environments:
                plan += restart(state, environment, ids)
    return plan


def known_relays(state: State) -> list[str]:
    """Return the addresses of the data relays of all machines, as HOST:PORT."""
    return sorted({relay for machine in state.processes.by("container") for relay in machine.relays.values()})


def relays_changed(state: State, machine: str, relays: dict[str, str]) -> Plan:
    """Take the relays of a task set with several hosts, and tell all machines if they changed."""
    before, process = known_relays(state), state.processes[machine]
    state.processes.put(replace(process, relays=relays))
    return _announce_relays(state, process, before) if known_relays(state) != before else []


def _announce_relays(state: State, process: Process, before: list[str]) -> Plan:
    """Tell a machine that has joined the addresses of the relays, and all machines if these changed."""
    relays = known_relays(state)
    if relays == before:
        told = [process.name] if relays else []
    else:
        told = [machine.name for machine in state.processes.by("container") if machine.name in state.joined]
    return [[Send(name, SetRelays(relays), Ref("relays", ""))] for name in told]


def environment_down(state: State, environment: Environment) -> Plan:
    """Take down the connections of an environment that died; remove it if its `restart` is `no`."""
    plan = take_down(state, environment.name)
    state.forget(environment.name)
    if environment.options.restart == "no":
        plan += remove_environment(state, environment, away=True)
    return plan


def restart(state: State, environment: Environment, ids: Ids) -> Plan:
    """Start a new life of an environment on the best machine; without one it waits for a machine."""
    again = replace(environment, run=ids(), machine=_best_place(state, environment))
    state.environments.put(again)
    return start(state, again)


def _best_place(state: State, environment: Environment) -> str:
    """Return the best machine for an environment that does not run, or an empty string."""
    try:
        return place(state, user_of(environment.name), environment.options, environment.name)
    except NoCapacity:
        return ""


def lost_with(state: State, process: str) -> list[Environment]:
    """Return the environments that are lost after the grace period of `process`, a machine or an endpoint, is over.

    An environment with a connected endpoint is alive: only its task set is gone. An environment whose machine is
    connected is not lost: that machine reports its end.
    """
    own = state.environments.get(process)
    return [
        environment
        for environment in [*state.environments.by(at(process)), *([own] if own else [])]
        if state.gone(environment.machine) and state.gone(environment.name)
    ]


def resettle(state: State, ids: Ids, most: float = math.inf) -> Plan:
    """Start new lives of environments that wait for a machine or were lost with theirs, where machines have room.

    An environment that finds no room stays as it is: it may still run on its machine when that comes back. The plan
    ends after the environment with which it has `most` sequences.
    """
    plan: Plan = []
    gone = ["", *(machine.name for machine in state.processes.by("container") if state.gone(machine.name))]
    waiting = [environment for machine in gone for environment in state.environments.by(at(machine))]
    room = most_free_slots(state) if waiting else 0  # mostly none waits, and each machine that joins asks
    for environment in waiting:
        if len(plan) >= most:
            break
        runs_on = bool(environment.machine) and not state.gone(environment.name)
        if not runs_on and environment.options.size <= room and _best_place(state, environment):
            plan += restart(state, environment, ids)
            room = most_free_slots(state)
    return plan


# --- robots -----------------------------------------------------------------------------------------------------------


def robot_arrived(
    state: State, robot: Robot, resume: str, ids: Ids, policy: Policy = UNLIMITED
) -> tuple[Outcome, bool]:
    """Add a robot whose socket is open at its endpoint; `resume` is the digest of the token that it presents.

    Returns:
        The effects that must be complete before the robot may go on, and whether it resumed its session. A robot that
        does not resume takes the place of the session that the same user's robot of this name has without a socket, or
        at an endpoint that is gone.

    Raises:
        AlreadyExists: The robotID is in use, by an environment or by a session with a socket.
        LimitExceeded: The user has all robots that `policy` allows.
    """
    name, (user, _, tag) = robot.name, robot.name.partition("/")
    check_robot_id(tag, "robotID")
    if name in state.environments:
        raise AlreadyExists(f"robotID {tag} is in use by an environment of yours", field="robotID")
    present = state.robots.get(name)
    if present is None:
        if robot.by.user == user:
            check_robots(state, user, policy)
        state.robots.put(robot)
        return Outcome([]), False
    if not resume or resume not in (present.session, present.previous):
        reachable = present.endpoint and not state.gone(present.endpoint)
        if robot.by.user != present.by.user or (reachable and name not in state.away):
            raise AlreadyExists(
                f"robotID {tag} is in use by another socket; a session token resumes it", field="robotID"
            )
        plan = robot_dismissed(state, name, "a robot of the same name took the place of this session")
        state.robots.put(robot)
        return Outcome(plan), False
    socket_moved(state, name, True)
    moved = present.endpoint != robot.endpoint
    plan = _leave_endpoint(state, present) if moved else []
    state.robots.put(replace(robot, previous=resume))
    if moved:
        plan += [
            [Send(robot.endpoint, Bind(interface_spec(each)), interface_ref(each)), MarkReady(ref(each))]
            for each in state.interfaces.by(name)
        ]
        plan += bring_up(state, [name], ids)
    return Outcome(plan), True


def _leave_endpoint(state: State, robot: Robot) -> Plan:
    plan: Plan = []
    for connection in connections_of(state, robot.name):
        plan += deactivate(state, connection)
    if robot.endpoint in state.joined:
        plan.append([Send(robot.endpoint, DropRobot(robot.name, "resumed elsewhere"), ref(robot))])
    return plan


def robot_left(state: State, name: str) -> Plan:
    """Remove a robot with its interfaces and connections; with a guest also what it added to environments.

    The interfaces of environments that it added for its own are removed too, unless others use them. The connections
    that others asked for wait for its return.
    """
    if name not in state.robots:
        return []
    plan = [sequence for use in state.uses.by(name) for sequence in end_use(state, use)]
    counterparts = _counterparts(state, name)
    plan += remove_interfaces(state, name, away=True) + _remove_guest_items(state, name)
    state.away.discard(name)
    state.robots.drop(name)
    plan += drop_waiting(state, name)
    for key in counterparts:
        interface = state.interfaces.get(key)
        if interface is not None and not state.connections.by(key) and not state.waiting.by(key):
            plan += remove_interface(state, interface)
    return plan


def _counterparts(state: State, robot: str) -> list[str]:
    """Return the keys of the interfaces that a robot added to environments and connected with its own."""
    connections = connections_of(state, robot)
    keys = dict.fromkeys(key for each in connections for key in (each.sender, each.receiver))
    return [key for key in keys if state.interfaces[key].by == robot]


def _remove_guest_items(state: State, name: str) -> Plan:
    """Remove the interfaces and nodes that a guest (`user/@tag`) added to environments."""
    user, _, robot = name.partition("/")
    plan: Plan = []
    if not is_guest(robot):
        return plan
    for environment in state.environments.by(user):
        for interface in state.interfaces.by(environment.name):
            if interface.tag.startswith(f"{robot}."):
                plan += remove_interface(state, interface, away=True)
        for node in state.nodes.by(environment.name):
            if node.tag.startswith(f"{robot}.") and not node.part_of:
                plan += remove_node(state, node)
    return plan


def robot_dismissed(state: State, name: str, reason: str) -> Plan:
    """End a robot's session at once and close its socket with the reason."""
    robot = state.robots.get(name)
    plan = robot_left(state, name)
    if robot is not None and robot.endpoint in state.joined:
        plan.append([Send(robot.endpoint, DropRobot(name, reason), ref(robot))])
    return plan


def user_gone(state: State, user: str) -> Plan:
    """Remove everything that a user has from the graph."""
    plan: Plan = []
    for robot in state.robots.by(user):
        plan += robot_dismissed(state, robot.name, "the user was removed")
    for environment in state.environments.by(user):
        plan += remove_environment(state, environment)
    plan += drop_waiting(state, all_of(user))
    for package in state.packages.by(user):
        state.packages.drop(package.key)
    plan += catalogue.user_gone(state, user)
    for secret in state.secrets.by(user):
        state.secrets.drop(secret.key)
    for package in state.packages.by(f">{user}"):  # a later user of this name must not inherit it
        state.packages.put(replace(package, shared=[each for each in package.shared if each != user]))
    return plan


def endpoint_gone(state: State, process: str) -> tuple[Plan, list[str]]:
    """Take down a Robot endpoint whose grace period is over.

    Returns:
        The effects, and the names of its robots, which have a grace period to resume at another endpoint.
    """
    plan = take_down(state, process)
    stranded = [robot.name for robot in state.robots.by(at(process))]
    for name in stranded:
        state.robots.put(replace(state.robots[name], endpoint=""))
    state.processes.drop(process)
    return plan, stranded


def _settle_robots(state: State, process: Process, hello: Hello) -> Plan:
    """Compare the robots of an endpoint with the records: those that it lacks are left without an endpoint."""
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
    """Note that a robot's socket was opened or lost."""
    if connected:
        state.away.discard(robot)
    else:
        state.away.add(robot)


def stranded(state: State) -> list[Robot]:
    """Return the robots without an endpoint, whose grace period runs."""
    return state.robots.by(at(""))
