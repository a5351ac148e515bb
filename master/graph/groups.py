"""Network groups: environments of one user that share a private network. A group exists while it has members.

Each group has a subnet of its own, because engines cannot tell two networks with the same subnet apart. In the original
all groups had 192.168.1.0/24, and its clients ask for such addresses: 192.168.1.N means host N of the group's subnet.
"""

from __future__ import annotations

from ipaddress import AddressValueError, IPv4Address, IPv4Network

from master.graph.records import Environment, EnvironmentOptions, user_of
from master.graph.state import State
from rce.control.calls.environments import Group
from rce.errors import AlreadyExists, InvalidRequest, NoCapacity
from rce.protocol.names import check_tag

ORIGINAL = IPv4Network("192.168.1.0/24")
PREFIX = 24
FIRST = 2  # .1 is the gateway's, where an engine has one


def join(state: State, user: str, options: EnvironmentOptions) -> tuple[str, str]:
    """Return the subnet and the address of a new environment in its group; two empty strings without a group.

    Raises:
        InvalidRequest: The address is malformed or not in the subnet, or there is no group.
        AlreadyExists: The address is in use.
        NoCapacity: No address or no subnet is free.
    """
    wanted = options.group_address
    if not options.group:
        if wanted:
            raise InvalidRequest("groupIP is given without a group", field="containerData.groupIP")
        return "", ""
    check_tag(options.group, "containerData.group")
    present = members(state, user, options.group)
    subnet = IPv4Network(present[0].subnet) if present else _free_subnet(state)
    taken = {other.address for other in present}
    address = _parse_address(wanted, subnet) if wanted else _free_address(subnet, taken, options.group)
    if address in taken:
        raise AlreadyExists(f"groupIP {wanted} is in use in group {options.group}", field="containerData.groupIP")
    return str(subnet), address


def members(state: State, user: str, group: str) -> list[Environment]:
    """Return the environments in a user's group."""
    return [each for each in state.environments.by(user) if each.options.group == group]


def spec(state: State, environment: Environment) -> Group | None:
    """Return the group of an environment as its engine creates it; None without a group."""
    user, group = user_of(environment.name), environment.options.group
    if not group:
        return None
    hosts = {each.name.partition("/")[2]: each.address for each in members(state, user, group)}
    return Group(f"{user}/{group}", environment.subnet, environment.address, hosts)


def of_user(state: State, user: str) -> dict[str, dict[str, str]]:
    """Return the user's groups by name: the address of each member by its name."""
    found: dict[str, dict[str, str]] = {}
    for environment in state.environments.by(user):
        if environment.options.group:
            found.setdefault(environment.options.group, {})[environment.name] = environment.address
    return found


def machine_of(state: State, user: str, group: str, moving: str = "") -> str:
    """Return the machine of a group, or an empty string; `moving` is a member that leaves its machine.

    A group stays on one machine, because an engine joins only its own environments.
    """
    machines = {each.machine for each in members(state, user, group) if each.name != moving} if group else set()
    return min((machine for machine in machines if machine and not state.gone(machine)), default="")


def _free_subnet(state: State) -> IPv4Network:
    taken = {each.subnet for each in state.environments if each.subnet}
    subnet = next((each for each in state.group_pool.subnets(new_prefix=PREFIX) if str(each) not in taken), None)
    if subnet is None:
        raise NoCapacity(
            f"all {len(taken)} networks of the pool {state.group_pool} for network groups are in use",
            networks=len(taken),
        )
    return subnet


def _free_address(subnet: IPv4Network, taken: set[str], group: str) -> str:
    address = next((each for each in map(str, _hosts(subnet)) if each not in taken), None)
    if address is None:
        raise NoCapacity(f"network group {group} is full: {len(taken)} addresses are in use")
    return address


def _parse_address(wanted: str, subnet: IPv4Network) -> str:
    try:
        address = IPv4Address(wanted)
    except AddressValueError:
        raise InvalidRequest(f"groupIP {wanted[:40]!r} is not an IPv4 address", field="containerData.groupIP") from None
    if address in ORIGINAL:
        address = subnet[int(address) - int(ORIGINAL[0])]
    hosts = _hosts(subnet)
    if address not in hosts:
        here = ORIGINAL[FIRST], ORIGINAL[-2]
        raise InvalidRequest(
            f"groupIP {wanted} is not one of {hosts[0]} to {hosts[-1]}, nor of {here[0]} to {here[1]}, which stand for "
            "them in every group",
            field="containerData.groupIP",
        )
    return str(address)


def _hosts(subnet: IPv4Network) -> list[IPv4Address]:
    return list(subnet.hosts())[FIRST - 1 :]
