"""Where environments run, which Robot endpoint a robot is sent to."""

from __future__ import annotations

from master.groups import machine_of
from master.records import Environment, Process, State, at
from rce.errors import NoCapacity, Unavailable
from rce.messages import ContainerData


def free_slots(state: State, machine: Process, moving: str = "") -> int:
    """Those that no environment has, except perhaps one that is about to move."""
    return machine.capacity - sum(other.options.size for other in _others(state, machine, moving))


def free_gpus(state: State, machine: Process, moving: str = "") -> int:
    return machine.gpus - sum(other.options.gpus for other in _others(state, machine, moving))


def _others(state: State, machine: Process, moving: str) -> list[Environment]:
    return [other for other in state.environments.by(at(machine.name)) if other.name != moving]


def place(state: State, user: str, options: ContainerData, moving: str = "") -> str:
    """The machine for an environment, as in the original: one that has this user already, else the emptiest.

    Members of a network group go to one machine. An empty string where none of those that are there can take it, but
    one that is expected back. Raises NoCapacity with the numbers. `moving` is its name if it leaves a place.
    """
    fitting = _fitting(state, user, options, moving)
    there = {name: free for name, free in fitting.items() if name in state.joined}
    own = {environment.machine for environment in state.environments.by(user) if environment.name != moving}
    return min(there, key=lambda name: (name not in own, -there[name], name), default="")


def _fitting(state: State, user: str, options: ContainerData, moving: str) -> dict[str, int]:
    """The free slots of each machine, there or expected, that can take the environment; NoCapacity without any."""
    machines = [machine for machine in state.processes.by("container") if not state.gone(machine.name)]
    if not machines:
        raise NoCapacity("no machine takes environments at present: start `rce container` on one, or wait for it")
    wanted = set(options.specialFeatures)
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
    spare = {machine.name: free_gpus(state, machine, moving) for machine in able}
    if options.gpus > max(spare.values()):
        raise NoCapacity(
            f"no machine has {options.gpus} free GPUs; the one with most has {max(0, *spare.values())}",
            field="containerData.gpus",
            asked=options.gpus,
            free=max(0, *spare.values()),
        )
    able = [machine for machine in able if spare[machine.name] >= options.gpus]
    free = {machine.name: free_slots(state, machine, moving) for machine in able}
    fitting = {name: slots for name, slots in free.items() if slots >= options.size}
    if not fitting:
        where = f"machine {home}, which has network group {options.group}, has not" if home else "no machine has"
        raise NoCapacity(
            f"{where} {options.size} free slots; the emptiest has {max(free.values())}",
            asked=options.size,
            free=max(free.values()),
        )
    return fitting


def robot_endpoint(state: State) -> Process:
    """The Robot endpoint with the fewest robots. Unavailable when there is none."""
    endpoints = [process for process in state.processes.by("robot") if process.name in state.joined]
    if not endpoints:
        raise Unavailable("no Robot endpoint is connected to the Master at present; try again in a moment")
    return min(endpoints, key=lambda process: (len(state.robots.by(at(process.name))), process.name))
