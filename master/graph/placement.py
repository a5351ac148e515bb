"""Placement: the machine of an environment, and the Robot endpoint of a robot."""

from __future__ import annotations

from master.graph.groups import machine_of
from master.graph.records import EnvironmentOptions, Process
from master.graph.state import State, amounts, at, user_at
from rce.errors import NoCapacity, Unavailable


def free_slots(state: State, machine: Process) -> int:
    """Return the free slots of a machine."""
    return machine.capacity - int(state.environments.total(at(machine.name), "size"))


def free_gpus(state: State, machine: Process) -> int:
    """Return the free GPUs of a machine."""
    return machine.gpus - int(state.environments.total(at(machine.name), "gpus"))


def most_free_slots(state: State) -> int:
    """Return the free slots of the connected machine that has most; 0 without one."""
    machines = (machine for machine in state.processes.by("container") if machine.name in state.joined)
    return max((free_slots(state, machine) for machine in machines), default=0)


def place(state: State, user: str, options: EnvironmentOptions, moving: str = "") -> str:
    """Return the machine for an environment: one that runs environments of the user, else that with most free slots.

    This is the rule of the original. Members of a network group go to one machine. The result is empty if no connected
    machine can take the environment but one within its grace period could. `moving` is the environment's name if it
    leaves a machine.

    Raises:
        NoCapacity: No machine can take it; the error has the numbers.
    """
    fitting = _fitting(state, user, options, moving)
    there = {name: free for name, free in fitting.items() if name in state.joined}
    mover = state.environments.get(moving)
    own = {name: state.environments.count(user_at(user, name)) for name in there}
    if mover is not None and mover.machine in own:
        own[mover.machine] -= 1
    return min(there, key=lambda name: (own[name] == 0, -there[name], name), default="")


def _fitting(state: State, user: str, options: EnvironmentOptions, moving: str) -> dict[str, int]:
    """Return the free slots of each machine, connected or expected back, that can take the environment."""
    machines = [machine for machine in state.processes.by("container") if not state.gone(machine.name)]
    if not machines:
        raise NoCapacity("no machine takes environments at present: start `rce container` on one, or wait for it")
    wanted = set(options.features)
    able = [machine for machine in machines if wanted <= set(machine.features)]
    if not able:
        raise NoCapacity(f"no machine offers the special features {', '.join(sorted(wanted))}")
    home = machine_of(state, user, options.group, moving)
    if home:
        able = [machine for machine in able if machine.name == home]
        if not able:
            raise NoCapacity(
                f"network group {options.group} is on machine {home}, which does not offer the special features "
                f"{', '.join(sorted(wanted))}; a group is on one machine"
            )
    if options.gpus:
        spare = {machine.name: free_gpus(state, machine) for machine in able}
        _count_as_free(state, moving, "gpus", spare)
        if options.gpus > max(spare.values()):
            most = max(0, *spare.values())  # a machine that joined again with fewer GPUs may use more than it has
            raise NoCapacity(
                f"no machine has {options.gpus} free GPUs; the one with most has {most}",
                field="containerData.gpus",
                asked=options.gpus,
                free=most,
            )
        able = [machine for machine in able if spare[machine.name] >= options.gpus]
    free = {machine.name: free_slots(state, machine) for machine in able}
    _count_as_free(state, moving, "size", free)
    fitting = {name: slots for name, slots in free.items() if slots >= options.size}
    if not fitting:
        most = max(0, *free.values())
        where = f"machine {home}, which has network group {options.group}, has not" if home else "no machine has"
        raise NoCapacity(
            f"{where} {options.size} free slots; the emptiest has {most}",
            asked=options.size,
            free=most,
        )
    return fitting


def _count_as_free(state: State, moving: str, amount: str, free: dict[str, int]) -> None:
    """Count what the environment `moving` uses on its machine as free."""
    mover = state.environments.get(moving)
    if mover is not None and mover.machine in free:
        free[mover.machine] += int(amounts(mover)[amount])


def robot_endpoint(state: State) -> Process:
    """Return the connected Robot endpoint with the fewest robots.

    Raises:
        Unavailable: No Robot endpoint is connected.
    """
    endpoints = [process for process in state.processes.by("robot") if process.name in state.joined]
    if not endpoints:
        raise Unavailable("no Robot endpoint is connected to the Master at present; try again in a moment")
    return min(endpoints, key=lambda process: (state.robots.count(at(process.name)), process.name))
