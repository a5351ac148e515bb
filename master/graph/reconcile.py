"""Reconciliation: processes join, leave and return, and are brought in line with the records."""

from __future__ import annotations

import math

from msgspec.structs import replace

from master.graph.changes import remove_environment, start
from master.graph.effects import MarkReady, Plan, Send
from master.graph.placement import most_free_slots, place
from master.graph.records import Environment, Process, Ref, Role, user_of
from master.graph.sessions import settle_robots
from master.graph.state import State, at
from master.graph.translation import interface_spec, node_spec, parameter_spec, recorder_spec
from master.graph.wiring import Ids, bring_up, link_spec, routes_of, take_down
from rce.control.calls.endpoints import PutSecrets, Secret, Sync
from rce.control.calls.environments import KeepEnvironments, SetRelays
from rce.control.calls.joining import Hello, SetRemovedMachines, SetRemovedUsers
from rce.errors import NoCapacity, Unavailable

KEEPERS: tuple[Role, ...] = ("container", "service")  # roles of processes that keep things of users


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
    if state.removed_users and process.role in KEEPERS:
        plan.append([_removed_users(state, process.name)])
    if process.role == "container":
        plan += _machine_joined(state, process, hello, ids)
        return plan + resettle(state, ids) + _announce_relays(state, process, relays)
    if process.role == "service":  # services have no part in the graph
        return plan
    if process.role == "robot":
        plan += settle_robots(state, process, hello)
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


def announce_removed_users(state: State) -> Plan:
    """Tell all connected processes that keep things of users which users were removed."""
    processes = [each for role in KEEPERS for each in state.processes.by(role)]
    return [[_removed_users(state, each.name)] for each in processes if each.name in state.joined]


def _removed_users(state: State, process: str) -> Send:
    return Send(process, SetRemovedUsers(state.removed_users), Ref("removed", "users"))


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
