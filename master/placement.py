"""Where environments run, which address they get in a network group, which Robot endpoint a robot is sent to."""

from __future__ import annotations

import ipaddress

from master.records import Process, State, at, user_of
from rce.errors import AlreadyExists, InvalidRequest, NoCapacity, Unavailable
from rce.messages import ContainerData

GROUP_NETWORK = ipaddress.IPv4Network("192.168.1.0/24")  # each group has this network for itself
GROUP_ADDRESSES = list(GROUP_NETWORK.hosts())[1:]  # .1 is the gateway's


def free_slots(state: State, machine: Process) -> int:
    return machine.capacity - sum(other.options.size for other in state.environments.by(at(machine.name)))


def place(state: State, user: str, options: ContainerData) -> str:
    """The machine for an environment, as in the original: one that has this user already, else the emptiest.

    Raises NoCapacity with the numbers.
    """
    machines = [machine for machine in state.processes.by("container") if machine.name in state.joined]
    if not machines:
        raise NoCapacity("no machine takes environments at present: start `rce container` on one, or wait for it")
    wanted = set(options.specialFeatures)
    able = [machine for machine in machines if wanted <= set(machine.features)]
    if not able:
        raise NoCapacity(f"no machine offers the special features {', '.join(sorted(wanted))}")
    free = {machine.name: free_slots(state, machine) for machine in able}
    fitting = [name for name, slots in free.items() if slots >= options.size]
    if not fitting:
        raise NoCapacity(
            f"no machine has {options.size} free slots; the emptiest has {max(free.values())}",
            asked=options.size,
            free=max(free.values()),
        )
    own = {environment.machine for environment in state.environments.by(user)}
    return min(fitting, key=lambda name: (name not in own, -free[name], name))


def group_address(state: State, user: str, options: ContainerData) -> str:
    """The address of a new environment in its network group, or an empty string without a group."""
    wanted = options.groupIP or options.groupIp
    if not options.group:
        if wanted:
            raise InvalidRequest("groupIP is given without a group", field="containerData.groupIP")
        return ""
    taken = {other.address for other in state.environments.by(user) if other.options.group == options.group}
    if not wanted:
        address = next((str(address) for address in GROUP_ADDRESSES if str(address) not in taken), "")
        if not address:
            raise NoCapacity(f"network group {options.group} is full: {len(taken)} addresses are in use")
        return address
    try:
        inside = ipaddress.IPv4Address(wanted) in GROUP_ADDRESSES
    except ipaddress.AddressValueError:
        raise InvalidRequest(f"groupIP {wanted[:40]!r} is not an IPv4 address", field="containerData.groupIP") from None
    if not inside:
        raise InvalidRequest(
            f"groupIP {wanted} is not one of {GROUP_ADDRESSES[0]} to {GROUP_ADDRESSES[-1]}",
            field="containerData.groupIP",
        )
    if wanted in taken:
        raise AlreadyExists(f"groupIP {wanted} is in use in group {options.group}", field="containerData.groupIP")
    return wanted


def robot_endpoint(state: State) -> Process:
    """The Robot endpoint with the fewest robots. Unavailable when there is none."""
    endpoints = [process for process in state.processes.by("robot") if process.name in state.joined]
    if not endpoints:
        raise Unavailable("no Robot endpoint is connected to the Master at present; try again in a moment")
    return min(endpoints, key=lambda process: (len(state.robots.by(at(process.name))), process.name))


def groups(state: State, user: str) -> dict[str, dict[str, str]]:
    """The user's network groups: address of each member by its name. A group exists while it has members."""
    found: dict[str, dict[str, str]] = {}
    for environment in state.environments.by(user):
        if environment.options.group and user_of(environment.name) == user:
            found.setdefault(environment.options.group, {})[environment.name] = environment.address
    return found
