"""Where environments run, which Robot endpoint a robot is sent to."""

from __future__ import annotations

from master.groups import machine_of
from master.records import Process, State, at
from rce.errors import NoCapacity, Unavailable
from rce.messages import ContainerData


def free_slots(state: State, machine: Process) -> int:
    return machine.capacity - sum(other.options.size for other in state.environments.by(at(machine.name)))


def free_gpus(state: State, machine: Process) -> int:
    return machine.gpus - sum(other.options.gpus for other in state.environments.by(at(machine.name)))


def place(state: State, user: str, options: ContainerData) -> str:
    """The machine for an environment, as in the original: one that has this user already, else the emptiest.

    Members of a network group go to one machine. Raises NoCapacity with the numbers.
    """
    machines = [machine for machine in state.processes.by("container") if machine.name in state.joined]
    if not machines:
        raise NoCapacity("no machine takes environments at present: start `rce container` on one, or wait for it")
    wanted = set(options.specialFeatures)
    able = [machine for machine in machines if wanted <= set(machine.features)]
    if not able:
        raise NoCapacity(f"no machine offers the special features {', '.join(sorted(wanted))}")
    home = machine_of(state, user, options.group)
    if home:
        able = [machine for machine in able if machine.name == home]
        if not able:
            raise NoCapacity(
                f"network group {options.group} is on machine {home}, which does not offer the special features "
                f"{', '.join(sorted(wanted))}; a group is on one machine"
            )
    spare = {machine.name: free_gpus(state, machine) for machine in able}
    if options.gpus > max(spare.values()):
        raise NoCapacity(
            f"no machine has {options.gpus} free GPUs; the one with most has {max(0, *spare.values())}",
            field="containerData.gpus",
            asked=options.gpus,
            free=max(0, *spare.values()),
        )
    able = [machine for machine in able if spare[machine.name] >= options.gpus]
    free = {machine.name: free_slots(state, machine) for machine in able}
    fitting = [name for name, slots in free.items() if slots >= options.size]
    if not fitting:
        where = f"machine {home}, which has network group {options.group}, has not" if home else "no machine has"
        raise NoCapacity(
            f"{where} {options.size} free slots; the emptiest has {max(free.values())}",
            asked=options.size,
            free=max(free.values()),
        )
    own = {environment.machine for environment in state.environments.by(user)}
    return min(fitting, key=lambda name: (name not in own, -free[name], name))


def robot_endpoint(state: State) -> Process:
    """The Robot endpoint with the fewest robots. Unavailable when there is none."""
    endpoints = [process for process in state.processes.by("robot") if process.name in state.joined]
    if not endpoints:
        raise Unavailable("no Robot endpoint is connected to the Master at present; try again in a moment")
    return min(endpoints, key=lambda process: (len(state.robots.by(at(process.name))), process.name))
