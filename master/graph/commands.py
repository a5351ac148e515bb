"""Commands of users: each changes the records and returns the effects that follow. Nothing here waits.

Everything is looked up under `user/`, so that another user's things do not exist here. A repeated command (its answer
was lost) accepts what it made the first time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, get_args

from msgspec.structs import replace

from master.graph import catalogue, changes, connections, groups, hard_limits, instances, secrets
from master.graph.changes import call_host, start
from master.graph.connections import split_kind
from master.graph.effects import MarkReady, Outcome, Plan, Send
from master.graph.limits import UNLIMITED, Policy, check_totals, granted
from master.graph.packages import resolve_all
from master.graph.placement import place
from master.graph.records import Connection, Environment, Interface, Parameter, Waiting, parameter_key, ref
from master.graph.state import State
from master.graph.translation import (
    interface_from,
    interface_spec,
    node_from,
    node_spec,
    options_from,
    parameter_spec,
    recorder_from,
    recorder_spec,
)
from master.graph.wiring import Ids, activate, interface_ref
from rce.control.calls.endpoints import Bind, DropParameter, PutParameter, StartNode, StartRecorder
from rce.errors import AlreadyExists, InvalidRequest, NotConnectable, NotFound
from rce.protocol import messages as m
from rce.protocol.names import check_new_name, check_tag, is_guest, parse_type, split_interface
from rce.protocol.variables import check_variables
from rce.spelling import tags, unknown, with_article

KINDS = get_args(m.InterfaceType)
TOPICS_OF_ROBOTS = ("PublisherConverter", "PublisherForwarder", "SubscriberConverter", "SubscriberForwarder")


class CommandContext(NamedTuple):
    """User and state of a command.

    `ids` makes identifiers, `policy` has the user's limits. `repeated`: the command was given before and its answer was
    lost. `robot` is the robotID by which it comes, empty for one by HTTP. `limits_of` returns the policy of any user.
    """

    state: State
    user: str
    ids: Ids
    policy: Policy = UNLIMITED
    repeated: bool = False
    robot: str = ""
    limits_of: Callable[[str], Policy] = lambda _: UNLIMITED

    @property
    def guest(self) -> str:
        """The robotID if it is a guest's: names under it are for the guest alone."""
        return self.robot if is_guest(self.robot) else ""

    def environment(self, tag: str, field: str = "containerTag") -> Environment:
        """Return the user's environment of this tag.

        Raises:
            NotFound: The user has no such environment.
        """
        environment = self.state.environments.get(f"{self.user}/{tag}")
        if environment is None:
            known = tags(each.name for each in self.state.environments.by(self.user))
            raise NotFound(unknown("environment", tag, known), field=field)
        return environment


def execute(context: CommandContext, command: m.Command) -> Outcome:
    """Apply one command.

    Raises:
        RceError: The error for the user; then nothing has changed. LimitExceeded if the policy does not allow it.
    """
    return HANDLERS[type(command)](context, command)


# --- environments -----------------------------------------------------------------------------------------------------


def create_container(context: CommandContext, command: m.CreateContainer) -> Outcome:
    """CC: add an environment and start it on the machine that placement chooses."""
    state, user, policy = context.state, context.user, context.policy
    check_tag(command.containerTag, "containerTag")
    name = f"{user}/{command.containerTag}"
    if context.repeated and name in state.environments:
        return Outcome([], needs=[ref(state.environments[name])])
    if name in state.environments or name in state.robots:
        kind = "environment" if name in state.environments else "robot"
        raise AlreadyExists(
            f"containerTag {command.containerTag} is in use by {with_article(kind)} of yours",
            field="containerTag",
            kind=kind,
        )
    check_variables(command.containerData.env)
    check_variables(secrets.variables(command.containerData.secrets))
    secrets.check(state, user, command.containerData.secrets)
    options = granted(policy, options_from(command.containerData))
    check_totals(state, user, policy, options)
    packages = resolve_all(state, user, options.packages)
    subnet, address = groups.join(state, user, options)
    machine = place(state, user, options)
    environment = Environment(name, options, context.ids(), machine, subnet, address, packages, policy.egress)
    state.environments.put(environment)
    return Outcome(start(state, environment), [ref(environment)])


def destroy_container(context: CommandContext, command: m.DestroyContainer) -> Outcome:
    """DC: remove an environment with all that is in it."""
    if context.repeated and f"{context.user}/{command.containerTag}" not in context.state.environments:
        return Outcome([])
    return Outcome(changes.remove_environment(context.state, context.environment(command.containerTag)))


# --- nodes and parameters ---------------------------------------------------------------------------------------------


def add_node(context: CommandContext, command: m.AddNode) -> Outcome:
    """CN: add a node to an environment and start it."""
    state = context.state
    owner = context.environment(command.containerTag).name
    check_new_name(command.nodeTag, "nodeTag", context.guest)
    _check_program(command)
    node = node_from(owner, command)
    present = state.nodes.get(node.key)
    if present == node and (context.repeated or command.existOk):
        return Outcome([], needs=[ref(node)])
    if present is not None and not command.existOk:
        raise AlreadyExists(f"nodeTag {command.nodeTag} is in use in {command.containerTag}", field="nodeTag")
    if present is None:
        hard_limits.check_count(state.nodes, owner, hard_limits.NODES, "nodeTag")
    state.nodes.put(node)
    for end in (node.key, *(each.key for each in state.ends.by(owner) if each.node.part_of == node.tag)):
        state.ends.drop(end)
    changes.drop_launched(state, node)
    return Outcome(call_host(state, node, StartNode(node_spec(node))), [ref(node)])


def _check_program(command: m.AddNode) -> None:
    if not command.exe and not command.launch:
        raise InvalidRequest("a node needs `exe`, an executable, or `launch`, a launch file", field="exe")
    if command.exe and command.launch:
        raise InvalidRequest("a node has either `exe` or `launch`, not both", field="launch")
    if command.launch and (command.name or command.namespace):
        field = "name" if command.name else "namespace"
        raise InvalidRequest(f"`{field}` is of single nodes: a launch file names its nodes itself", field=field)


def remove_node(context: CommandContext, command: m.RemoveNode) -> Outcome:
    """CN: remove a node and stop it."""
    owner = context.environment(command.containerTag).name
    node = context.state.nodes.get(f"{owner}/{command.nodeTag}")
    if node is None:
        if context.repeated:
            return Outcome([])
        raise NotFound(f"{command.containerTag} has no node {command.nodeTag}", field="nodeTag")
    if node.part_of:
        raise InvalidRequest(
            f"node {node.tag} is part of launch {node.part_of}, which ends as a whole: remove {node.part_of}",
            field="nodeTag",
        )
    return Outcome(changes.remove_node(context.state, node))


def set_parameter(context: CommandContext, command: m.SetParameter) -> Outcome:
    """CN: set a parameter of an environment, for all of its nodes or for one."""
    state = context.state
    owner = context.environment(command.containerTag).name
    if command.nodeTag:
        check_tag(command.nodeTag, "nodeTag")
    parameter = Parameter(owner, command.name, command.value, command.nodeTag)
    hard_limits.check_parameter(state, parameter)
    before = state.parameters.get(parameter.key)
    state.parameters.put(parameter)
    plan = call_host(state, parameter, PutParameter(parameter_spec(parameter)))
    return Outcome(plan, [ref(parameter)], parameter, before)


def delete_parameter(context: CommandContext, command: m.DeleteParameter) -> Outcome:
    """CN: remove a parameter from an environment."""
    owner = context.environment(command.containerTag).name
    parameter = context.state.parameters.drop(parameter_key(owner, command.nodeTag, command.name))
    if parameter is None:
        if context.repeated:
            return Outcome([])
        raise NotFound(f"{command.containerTag} has no parameter {command.name[:80]!r}", field="name")
    return Outcome(call_host(context.state, parameter, DropParameter(parameter_spec(parameter).key)))


# --- recorders --------------------------------------------------------------------------------------------------------


def add_recorder(context: CommandContext, command: m.AddRecorder) -> Outcome:
    """CN: add a recorder to an environment and start it."""
    state = context.state
    owner = context.environment(command.containerTag).name
    check_tag(command.recorderTag, "recorderTag")
    recorder = recorder_from(owner, command)
    present = state.recorders.get(recorder.key)
    if present == recorder and (context.repeated or command.existOk):
        return Outcome([], needs=[ref(recorder)])
    if present is not None and not command.existOk:
        raise AlreadyExists(
            f"recorderTag {command.recorderTag} is in use in {command.containerTag}", field="recorderTag"
        )
    if present is None:
        hard_limits.check_count(state.recorders, owner, hard_limits.RECORDERS, "recorderTag")
    state.recorders.put(recorder)
    return Outcome(call_host(state, recorder, StartRecorder(recorder_spec(recorder))), [ref(recorder)])


def remove_recorder(context: CommandContext, command: m.RemoveRecorder) -> Outcome:
    """CN: remove a recorder and stop it; its recordings are kept."""
    owner = context.environment(command.containerTag).name
    recorder = context.state.recorders.get(f"{owner}/{command.recorderTag}")
    if recorder is None:
        if context.repeated:
            return Outcome([])
        raise NotFound(f"{command.containerTag} has no recorder {command.recorderTag[:80]!r}", field="recorderTag")
    return Outcome(changes.remove_recorder(context.state, recorder))


# --- interfaces -------------------------------------------------------------------------------------------------------


def add_interface(context: CommandContext, command: m.AddInterface) -> Outcome:
    """CN: add an interface to a robot or an environment."""
    state = context.state
    kind = m.ALIASES.get(command.interfaceType, command.interfaceType)
    owner = _owner_of_new_interface(context, command, kind)
    parse_type(command.className)
    interface = interface_from(context.ids(), owner, kind, command)
    if context.robot and owner in state.environments:
        interface = replace(interface, by=f"{context.user}/{context.robot}")
    present = state.interfaces.get(interface.key)
    if present is not None:
        if context.repeated and (present.kind, present.type) == (kind, command.className):
            return Outcome([], needs=[ref(present)])
        raise AlreadyExists(
            f"interfaceTag {command.interfaceTag} is in use at {command.endpointTag}", field="interfaceTag"
        )
    hard_limits.check_count(state.interfaces, owner, hard_limits.INTERFACES, "interfaceTag")
    state.interfaces.put(interface)
    host = state.host(owner)
    bind = Bind(interface_spec(interface))
    plan: Plan = [[Send(host, bind, interface_ref(interface)), MarkReady(ref(interface))]] if host else []
    follows = connections.restore(state, interface, context.policy, context.ids)
    return Outcome(plan, [ref(interface)], follows=follows)


def _owner_of_new_interface(context: CommandContext, command: m.AddInterface, kind: str) -> str:
    if kind not in KINDS:
        raise InvalidRequest(
            f"interfaceType {kind[:80]!r} does not exist; it is one of {', '.join(KINDS)}", field="interfaceType"
        )
    if command.delivery != m.Delivery() and kind not in TOPICS_OF_ROBOTS:
        raise InvalidRequest(
            f"{with_article(kind)} has no delivery: give it to an interface of a robot for a topic, which is one of "
            f"{', '.join(TOPICS_OF_ROBOTS)}",
            field="delivery",
        )
    if command.codec and kind not in ("PublisherConverter", "SubscriberConverter"):
        raise InvalidRequest(
            f"{with_article(kind)} has no codec: give it to an interface of a robot for a topic, which is a "
            "PublisherConverter or a SubscriberConverter",
            field="codec",
        )
    for option in ("fields", "decimate"):
        if kind.startswith("Subscriber") and getattr(command.delivery, option) != getattr(m.Delivery(), option):
            raise InvalidRequest(
                f"{with_article(kind)} has no delivery.{option}: the platform makes messages to robots smaller, which "
                "a Publisher sends; a robot that sends leaves out by itself what nobody needs",
                field=f"delivery.{option}",
            )
    if split_kind(kind)[1] == "Interface":
        owner = context.environment(command.endpointTag, "endpointTag").name
        check_new_name(command.interfaceTag, "interfaceTag", context.guest)
        if command.format not in m.IMAGE_FORMATS:
            raise InvalidRequest(
                f"the format {command.format} is one of robots' interfaces: give it to the interface at the robot",
                field="format",
            )
        return owner
    owner = f"{context.user}/{command.endpointTag}"
    if owner not in context.state.robots:
        wanted = with_article(str(kind))
        raise NotFound(f"there is no robot {command.endpointTag[:80]!r} to take {wanted}", field="endpointTag")
    check_tag(command.interfaceTag, "interfaceTag")
    return owner


def remove_interface(context: CommandContext, command: m.RemoveInterface) -> Outcome:
    """CN: remove an interface and its connections."""
    interface = context.state.interfaces.get(f"{context.user}/{command.endpointTag}/{command.interfaceTag}")
    if interface is None:
        if context.repeated:
            return Outcome([])
        raise NotFound(
            f"{command.endpointTag[:80]} has no interface {command.interfaceTag[:80]!r}", field="interfaceTag"
        )
    return Outcome(changes.remove_interface(context.state, interface))


# --- connections ------------------------------------------------------------------------------------------------------


def connect(context: CommandContext, command: m.Connect) -> Outcome:
    """CX: connect two interfaces of opposite kinds and the same type."""
    state = context.state
    one, other = _pair(context, command.tagA, command.tagB)
    connection = connections.joining(one, other)
    robot = f"{context.user}/{context.robot}"
    by = robot if robot in (one.owner, other.owner) else ""
    present = state.connections.get(connection.key)
    if present is not None:
        if present.restored:  # two want it now, so it does not end with one of them
            state.connections.put(replace(present, restored=False, by=by if by == present.by else ""))
        elif not context.repeated:
            raise AlreadyExists(f"{command.tagA} and {command.tagB} are connected already")
        return Outcome([], needs=[ref(connection)])
    connections.check_new(state, connection, context.policy)
    connection = replace(connection, by=by)
    state.connections.put(connection)
    return Outcome(activate(state, connection, context.ids), [ref(connection)])


def disconnect(context: CommandContext, command: m.Disconnect) -> Outcome:
    """CX: disconnect two interfaces, of which one may be away."""
    for sides in ((command.tagA, command.tagB), (command.tagB, command.tagA)):
        sender_key, receiver_key = (f"{context.user}/{side}" for side in sides)
        if context.state.waiting.drop(Waiting(sender_key, receiver_key).key) is not None:
            return Outcome([])
    one, other = _pair(context, command.tagA, command.tagB)
    for sender, receiver in ((one, other), (other, one)):
        connection = context.state.connections.get(Connection(sender.key, receiver.key).key)
        if connection is not None:
            return Outcome(changes.remove_connection(context.state, connection))
    if context.repeated:
        return Outcome([])
    raise NotFound(f"{command.tagA} and {command.tagB} are not connected")


def _pair(context: CommandContext, tag_a: str, tag_b: str) -> tuple[Interface, Interface]:
    found = []
    for field, tag in (("tagA", tag_a), ("tagB", tag_b)):
        endpoint, name = split_interface(tag, field)
        interface = context.state.interfaces.get(f"{context.user}/{endpoint}/{name}")
        if interface is None:
            raise NotFound(f"there is no interface {tag}", field=field)
        found.append(interface)
    if found[0] is found[1]:
        raise NotConnectable(f"{tag_a} cannot be connected with itself")
    return found[0], found[1]


# --- services of the catalogue ----------------------------------------------------------------------------------------


def use_service(context: CommandContext, command: m.UseService) -> Outcome:
    """CN: let the robot take part in an instance of a service; without a robot, start an instance of the user's own.

    A robot that takes part already gets the answer again: it may not have received the first one.
    """
    state, user = context.state, context.user
    offer = catalogue.resolve(state, user, command.service)
    tag = check_tag(command.containerTag or catalogue.name_of(offer), "containerTag")
    robot = f"{user}/{context.robot}" if context.robot else ""
    present = state.uses.get(f"{robot}/{tag}") if robot else None
    if present is not None:
        if present.offer == offer.name:
            return instances.joined(state, present)
        raise AlreadyExists(
            f"{context.robot} uses {present.offer} as {tag}: give another containerTag", field="service"
        )
    if robot:
        instances.check_robot(state, offer, robot, tag, context.policy)
    if offer.is_shared:
        chosen = instances.shared(state, user, robot, offer, context.limits_of, context.ids)
    else:
        chosen = instances.own(state, user, tag, offer, context.policy, context.ids)
    if not robot:
        return chosen.outcome
    return instances.join(state, chosen, offer, robot, tag, context.ids, raw=command.raw)


def leave_service(context: CommandContext, command: m.LeaveService) -> Outcome:
    """CN: end the robot's part in a service."""
    use = context.state.uses.get(f"{context.user}/{context.robot}/{command.containerTag}")
    if use is None:
        if context.repeated:
            return Outcome([])
        raise NotFound(f"the robot uses no service as {command.containerTag[:80]!r}", field="containerTag")
    return Outcome(changes.end_use(context.state, use))


HANDLERS: dict[type[m.Command], Callable[[CommandContext, Any], Outcome]] = {
    m.CreateContainer: create_container,
    m.DestroyContainer: destroy_container,
    m.AddNode: add_node,
    m.RemoveNode: remove_node,
    m.SetParameter: set_parameter,
    m.DeleteParameter: delete_parameter,
    m.AddRecorder: add_recorder,
    m.RemoveRecorder: remove_recorder,
    m.AddInterface: add_interface,
    m.RemoveInterface: remove_interface,
    m.UseService: use_service,
    m.LeaveService: leave_service,
    m.Connect: connect,
    m.Disconnect: disconnect,
}
"""The function of each command."""
