"""Instances of services: environments that run an offer, and the robots that take part in them.

The instance of a service that serves one robot is an environment of the robot's user, in its name space and limits. A
shared one is an environment of the publisher: a robot takes part by interfaces that are made for it as the service
declares them, and sees nothing else of the publisher. Decisions are functions of records and a clock that is given.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

from msgspec.structs import replace

from master.graph import hard_limits, secrets
from master.graph.catalogue import SHIPPED, name_of
from master.graph.catalogue_records import Instance, Offer, OfferedNode, Port, Tally, Use
from master.graph.changes import call_host, remove_environment, start
from master.graph.connections import joining
from master.graph.effects import MarkReady, Outcome, Plan, Send
from master.graph.limits import Policy, check_connections, check_totals, granted
from master.graph.placement import place
from master.graph.records import Environment, Interface, Node, Parameter, Ref, ref, user_of
from master.graph.state import State
from master.graph.translation import interface_spec, node_spec, parameter_spec
from master.graph.wiring import Ids, activate, interface_ref
from rce.control.calls.endpoints import Bind, PutParameter, StartNode
from rce.errors import AlreadyExists, InvalidName, InvalidRequest, LimitExceeded, NoCapacity, NotFound, Unavailable
from rce.protocol.messages import UsedInterface, UsedService
from rce.protocol.names import MAX_TAG

LimitsOf = Callable[[str], Policy]
BUSY = 0.8  # share of its robots' places from which an instance is relieved by another
_SIDES = {  # interface in the instance, and at the robot
    "takes": ("Publisher", "Subscriber"),
    "gives": ("Subscriber", "Publisher"),
    "service": ("ServiceClient", "ServiceProvider"),
    "action": ("ActionClient", "ActionProvider"),
}


class Chosen(NamedTuple):
    """The environment of an instance, and what must be complete before a robot can use it."""

    environment: Environment
    outcome: Outcome


# --- choice -----------------------------------------------------------------------------------------------------------


def own(state: State, user: str, tag: str, offer: Offer, policy: Policy, ids: Ids) -> Chosen:
    """Return the user's instance of this tag, started if there is none.

    Raises:
        AlreadyExists: The tag is in use by something else, or the instance by another robot.
        Unavailable: The instance runs the offer as it was before.
        RceError: The user may not have that environment, or no machine has room.
    """
    name = f"{user}/{tag}"
    instance, environment = state.instances.get(name), state.environments.get(name)
    if environment is None and name not in state.robots:
        return _start(state, name, offer, policy, ids)
    if environment is None or instance is None or instance.offer != offer.name:
        raise AlreadyExists(
            f"containerTag {tag} is in use by an environment or robot of yours: give another containerTag",
            field="containerTag",
        )
    if used := state.uses.by(name):
        raise AlreadyExists(
            f"{tag} is in use by robot {used[0].robot.partition('/')[2]}: give another containerTag",
            field="containerTag",
        )
    if instance.revision != offer.revision:
        raise Unavailable(
            f"{tag} runs {name_of(offer)} as it was before it was published again, and is stopped now: try again in "
            "some seconds, or give another containerTag",
            field="containerTag",
        )
    return Chosen(environment, Outcome([], needs=_contents(state, name)))


def shared(state: State, user: str, robot: str, offer: Offer, limits_of: LimitsOf, ids: Ids) -> Chosen:
    """Return a shared instance with a place for a robot of `user`, started if there may be a further one.

    Raises:
        InvalidRequest: There is no robot to take part.
        AlreadyExists: The robot uses the service under another tag.
        LimitExceeded: The user has as many robots there as may be.
        NoCapacity: All instances are full.
    """
    if not robot:
        raise InvalidRequest(f"{name_of(offer)} is shared: say which robot shall use it", field="robot")
    for use in state.uses.by(robot):
        if use.offer == offer.name:  # what a robot has in a shared instance is named after the robot
            raise AlreadyExists(
                f"{robot.partition('/')[2]} uses {name_of(offer)} already, with containerTag {use.tag}", field="service"
            )
    mine = sum(user_of(use.robot) == user for use in state.uses.by(offer.name))
    if offer.most_per_user and mine >= offer.most_per_user:
        raise LimitExceeded(
            f"{mine} of your robots use {offer.name}, the most of one user", field="service", limit=offer.most_per_user
        )
    current = instances_of(state, offer)
    if (found := with_place(state, offer, current)) is not None:
        return Chosen(state.environments[found], Outcome([], needs=_contents(state, found)))
    if len(current) >= offer.most:
        raise NoCapacity(
            f"all {len(current)} instances of {offer.name} are full; try again later", field="service", limit=offer.most
        )
    return start_shared(state, offer, limits_of, ids)


def instances_of(state: State, offer: Offer) -> list[str]:
    """Return the environments that run an offer as it is now."""
    return [each.environment for each in state.instances.by(offer.name) if each.revision == offer.revision]


def with_place(state: State, offer: Offer, environments: list[str]) -> str | None:
    """Return the instance for one more robot: the fullest that is not busy, else the emptiest with a place."""
    robots = {name: state.uses.count(name) for name in environments}
    quiet = [name for name, count in robots.items() if count + 1 <= BUSY * offer.robots]
    if quiet:
        return max(quiet, key=lambda name: robots[name])
    free = [name for name, count in robots.items() if count < offer.robots]
    return min(free, key=lambda name: robots[name], default=None)


def start_shared(state: State, offer: Offer, limits_of: LimitsOf, ids: Ids) -> Chosen:
    """Start a further shared instance, within the limits of the publisher.

    It is not taken back when the robot that needed it fails: others may be waiting for it.
    """
    user, name = user_of(offer.name), name_of(offer)
    taken = {each.name for table in (state.environments, state.robots) for each in table.by(user)}
    number = next(number for number in range(1, len(taken) + 2) if f"{user}/{name}_{number}" not in taken)
    chosen = _start(state, f"{user}/{name}_{number}", offer, limits_of(user), ids)
    return Chosen(chosen.environment, replace(chosen.outcome, awaits=[], needs=chosen.outcome.awaits))


def _start(state: State, name: str, offer: Offer, policy: Policy, ids: Ids) -> Chosen:
    """Add the environment of an instance with its nodes and parameters, which it gets when it joins."""
    user = user_of(name)
    options = granted(policy, offer.options)
    if options.secrets and not offer.is_shared:  # one that was published before this was refused
        raise InvalidRequest(
            f"{name_of(offer)} names secrets, which would be yours: ask its publisher to publish it without them",
            field="service",
        )
    check_totals(state, user, policy, options)
    secrets.check(state, user, options.secrets)
    machine = place(state, user, options)
    environment = Environment(name, options, ids(), machine, packages=offer.packages, egress=policy.egress)
    state.environments.put(environment)
    state.instances.put(Instance(name, offer.name, offer.revision))
    for key, value in offer.parameters.items():
        state.parameters.put(Parameter(name, key, value))
    for node in offer.nodes:
        if not (node.per_robot and offer.is_shared):
            _put_node(state, name, node)
    return Chosen(environment, Outcome(start(state, environment), _contents(state, name)))


def _contents(state: State, name: str) -> list[Ref]:
    """Return what of an instance must be ready before a robot uses it: all but the items of other robots."""
    of_robots = {key for use in state.uses.by(name) for key in use.nodes}
    nodes = [node for node in state.nodes.by(name) if node.key not in of_robots]
    return [ref(state.environments[name]), *map(ref, nodes)]


def _put_node(state: State, owner: str, offered: OfferedNode, prefix: str = "") -> Node:
    """Add a node of an offer; with a prefix that of one robot, in its namespace."""
    tag = f"{prefix}_{offered.tag}" if prefix else offered.tag
    namespace = "/".join(["", prefix, offered.namespace.strip("/")]).rstrip("/") if prefix else offered.namespace
    program = (offered.package, offered.executable, offered.arguments)
    node = Node(owner, tag, *program, offered.name, namespace, offered.restart)
    state.nodes.put(node)
    for key, value in offered.parameters.items():
        state.parameters.put(Parameter(owner, key, value, tag))
    return node


# --- robots -----------------------------------------------------------------------------------------------------------


def namespace(robot: str) -> str:
    """Return the ROS namespace of a robot (`user/robotID`) in shared instances, `USER_ROBOT`.

    Different robots have different ones: `Z` begins the two hex digits of a character, also of `_` and of `Z` itself.
    """
    user, _, tag = robot.partition("/")
    return "_".join(re.sub(r"[^A-Za-y0-9]", lambda found: f"Z{ord(found[0]):02x}", part) for part in (user, tag))


def check_robot(state: State, offer: Offer, robot: str, tag: str, policy: Policy) -> None:
    """Check, before anything is changed, that a robot may take part in a service under a tag.

    Raises:
        NotFound: There is no such robot.
        AlreadyExists: It has an interface of one of the names.
        LimitExceeded: It may not have that many interfaces, or its user that many connections.
        InvalidName: A name would be too long.
    """
    user, _, name = robot.partition("/")
    if robot not in state.robots:
        raise NotFound(f"there is no robot {name[:80]!r} that is connected", field="robot")
    for port in offer.ports:
        if f"{robot}/{tag}_{port.name}" in state.interfaces:
            raise AlreadyExists(f"{name} has an interface {tag}_{port.name} already", field="containerTag")
    longest = max((len(each) for each in _names(offer, robot, tag)), default=0)
    if longest > MAX_TAG:
        raise InvalidName(f"a name made of user, robot and service has {longest} characters, more than {MAX_TAG}")
    hard_limits.check_count(state.interfaces, robot, hard_limits.INTERFACES - len(offer.ports) + 1, "containerTag")
    check_connections(state, user, policy, len(offer.ports))
    hard_limits.check_lossless(state, user, sum(port.qos.history == "keep_all" for port in offer.ports))


def _names(offer: Offer, robot: str, tag: str) -> list[str]:
    prefix = namespace(robot)
    ports, nodes = [port.name for port in offer.ports], [node.tag for node in offer.nodes]
    return [f"{each}_{name}" for each in (tag, prefix) for name in (*ports, *nodes)]


def join(state: State, chosen: Chosen, offer: Offer, robot: str, tag: str, ids: Ids, *, raw: bool) -> Outcome:
    """Make the interfaces of a robot that `check_robot` accepts, here and in the instance, and connect them.

    Raises:
        AlreadyExists: The instance has something of that name, which its owner has added.
    """
    owner = chosen.environment.name
    prefix = namespace(robot) if offer.is_shared else ""
    pairs = [_pair(port, owner, robot, tag, prefix, raw, ids) for port in offer.ports]
    nodes = [node for node in offer.nodes if node.per_robot and prefix]
    for key, table in [(inner.key, state.interfaces) for inner, _ in pairs] + [
        (f"{owner}/{prefix}_{node.tag}", state.nodes) for node in nodes
    ]:
        if key in table:
            raise AlreadyExists(f"{key.partition('/')[2]} exists already", field="containerTag")
    plan, awaits = list(chosen.outcome.plan), list[Ref]()
    started = [_put_node(state, owner, node, prefix) for node in nodes]
    for node in started:
        plan += _node_plan(state, node)
        awaits.append(ref(node))
    for interface in (interface for pair in pairs for interface in pair):
        state.interfaces.put(interface)
        plan += _bind(state, interface)
        awaits.append(ref(interface))
    guest_user = user_of(robot) if user_of(robot) != user_of(owner) else ""
    for inner, outer in pairs:
        connection = replace(joining(inner, outer), by=robot, guest_user=guest_user)
        state.connections.put(connection)
        plan += activate(state, connection, ids)
        awaits.append(ref(connection))
    keys = [interface.key for pair in pairs for interface in pair]
    use = Use(robot, tag, offer.name, owner, keys, [node.key for node in started])
    state.uses.put(use)
    _count(state, offer, user_of(robot))
    needs = [*chosen.outcome.needs, *awaits]
    return replace(chosen.outcome, plan=plan, needs=needs, use=use, service=_answer(state, offer, use))


def joined(state: State, use: Use) -> Outcome:
    """Return the outcome of a repeated command: it waits for what the first attempt made."""
    kept = [state.interfaces[key] for key in use.interfaces if key in state.interfaces]
    links = {each.key: each for interface in kept for each in state.connections.by(interface.key)}
    nodes = [state.nodes[key] for key in use.nodes if key in state.nodes]
    needs = [*_contents(state, use.environment), *map(ref, nodes), *map(ref, kept), *map(ref, links.values())]
    return Outcome([], needs=needs, service=_answer(state, state.offers[use.offer], use))


def _pair(
    port: Port, owner: str, robot: str, tag: str, prefix: str, raw: bool, ids: Ids
) -> tuple[Interface, Interface]:
    """Return the interfaces of a port in the instance and at the robot."""
    inner, outer = _SIDES[port.kind]
    inner_tag = f"{prefix}_{port.name}" if prefix else port.name
    relative = not port.address.startswith("/")
    address = "/".join(["", *([prefix] if prefix else []), port.address]) if relative else port.address
    side = outer + ("Forwarder" if raw else "Converter")
    return (
        Interface(ids(), owner, inner_tag, f"{inner}Interface", port.type, address, port.qos, by=robot),
        Interface(ids(), robot, f"{tag}_{port.name}", side, port.type, "", port.qos),
    )


def _bind(state: State, interface: Interface) -> Plan:
    host = state.host(interface.owner)
    call = Bind(interface_spec(interface))
    return [[Send(host, call, interface_ref(interface)), MarkReady(ref(interface))]] if host else []


def _node_plan(state: State, node: Node) -> Plan:
    """Return the calls that give a node its parameters, then start it."""
    plan: Plan = []
    for parameter in state.parameters.by(node.owner):
        if parameter.node == node.tag:
            plan += call_host(state, parameter, PutParameter(parameter_spec(parameter)))
    return plan + call_host(state, node, StartNode(node_spec(node)))


def _count(state: State, offer: Offer, user: str) -> None:
    before = state.tallies.get(Tally(offer.name, user, 0).key)
    state.tallies.put(Tally(offer.name, user, 1 + (before.uses if before else 0)))


def _answer(state: State, offer: Offer, use: Use) -> UsedService:
    own = [state.interfaces[key] for key in use.interfaces if key.startswith(f"{use.robot}/")]
    found = [UsedInterface(each.tag.removeprefix(f"{use.tag}_"), each.tag, each.kind, each.type) for each in own]
    return UsedService(offer.name.removeprefix(f"{SHIPPED}/"), use.tag, offer.is_shared, found)


# --- number -----------------------------------------------------------------------------------------------------------


def missing(state: State, offer: Offer) -> int:
    """Return how many shared instances to start: for the lower bound, and one when those there are busy."""
    if not offer.is_shared:
        return 0
    there = instances_of(state, offer)
    robots = sum(state.uses.count(name) for name in there)
    wanted = max(offer.least, math.ceil(robots / (BUSY * offer.robots)))
    return max(0, min(wanted, offer.most) - len(there))


def idle(state: State, empty_since: Mapping[str, float], now: float) -> list[Environment]:
    """Return the environments of instances to stop: those without robots for the idle time, down to the lower bound.

    An instance of an offer that was removed or published again is stopped as soon as it has no robots.
    """
    found: list[Environment] = []
    spare = {offer.name: len(instances_of(state, offer)) - offer.least for offer in state.offers}
    for instance in state.instances:
        offer, since = state.offers.get(instance.offer), empty_since.get(instance.environment)
        environment = state.environments.get(instance.environment)
        current = offer if offer is not None and offer.revision == instance.revision else None
        if environment is None or since is None or now - since < (current.idle if current is not None else 0):
            continue
        if current is not None and current.is_shared:
            if spare[current.name] <= 0:
                continue
            spare[current.name] -= 1
        found.append(environment)
    return found


def stop(state: State, environments: list[Environment]) -> Plan:
    """Stop the environments of instances."""
    return [sequence for each in environments for sequence in remove_environment(state, each)]


def empty(state: State) -> set[str]:
    """Return the environments of instances in which no robot takes part."""
    return {each.environment for each in state.instances if not state.uses.count(each.environment)}
