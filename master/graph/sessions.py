"""Sessions of robots: robots arrive, resume, leave, and are moved from Robot endpoints that are gone."""

from __future__ import annotations

from msgspec.structs import replace

from master.graph import catalogue
from master.graph.changes import end_use, remove_environment, remove_interface, remove_interfaces, remove_node
from master.graph.connections import drop_waiting
from master.graph.effects import MarkReady, Outcome, Plan, Send
from master.graph.limits import UNLIMITED, Policy, check_robots
from master.graph.records import Process, Robot, ref
from master.graph.state import State, all_of, at
from master.graph.translation import interface_spec
from master.graph.wiring import Ids, bring_up, connections_of, deactivate, interface_ref, take_down
from rce.control.calls.endpoints import Bind
from rce.control.calls.joining import Hello
from rce.control.calls.robots import DropRobot
from rce.errors import AlreadyExists
from rce.protocol.names import check_robot_id, is_guest


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


def settle_robots(state: State, process: Process, hello: Hello) -> Plan:
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
