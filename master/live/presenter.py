"""Presenter: views of records for the API and the feed."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from typing import Literal
from urllib.parse import urlsplit

from master.execution.readiness import Readiness
from master.graph.groups import of_user
from master.graph.placement import free_gpus, free_slots
from master.graph.records import (
    Connection,
    Environment,
    Interface,
    IoRates,
    Node,
    NodeEnd,
    Parameter,
    Process,
    Recorder,
    Robot,
    ref,
)
from master.graph.state import State, at
from master.graph.translation import container_data, delivery_message, qos_message
from rce.api.views import (
    ConnectionView,
    EnvironmentView,
    GroupView,
    InterfaceView,
    MachineView,
    NodeEndView,
    NodeView,
    ParameterView,
    Rate,
    RecorderView,
    RobotView,
    Usage,
)
from rce.api.views.resources import EnvironmentState
from rce.protocol.names import is_guest

ROLES = ("container", "robot", "service")
_HOST = re.compile(r"(?:tcp|relay):(.+):\d+(?:/|$)")


class Presenter:
    """Makes views. `rates` and `usage` have the last measurements, filled by `Gauges`.

    Keys of `rates` are those of interfaces and connections, of `usage` those of environments.
    """

    def __init__(self, state: State, readiness: Readiness) -> None:
        self.state = state
        self.rates: dict[str, Rate] = {}
        self.usage: dict[str, Usage] = {}
        self._readiness = readiness

    def robot(self, record: Robot) -> RobotView:
        """Return the view of a robot."""
        user, tag = _parts(record.name)
        return RobotView(
            user,
            tag,
            "connected" if record.endpoint in self.state.joined and record.name not in self.state.away else "away",
            record.endpoint,
            self.state.interfaces.count(record.name),
            record.by.user if is_guest(tag) else "",
        )

    def environment(self, record: Environment) -> EnvironmentView:
        """Return the view of an environment."""
        name = record.name
        state = self.state
        return EnvironmentView(
            *_parts(name),
            self._state_of(record),
            record.machine,
            container_data(record.options),
            record.address,
            record.egress,
            record.packages,
            state.nodes.count(name),
            state.parameters.count(name),
            state.interfaces.count(name),
            self.usage.get(name),
            self._not_enforced(record),
            state.recorders.count(name),
        )

    def _not_enforced(self, record: Environment) -> list[str]:
        """Return the options of an environment that its machine does not enforce, and `egress` if it is limited."""
        machine = self.state.processes.get(record.machine)
        if machine is None:
            return []
        options = record.options
        asked = {name for name in options.__struct_fields__ if getattr(options, name) not in (0, IoRates())}
        asked |= {"egress"} if record.egress != "all" else set()
        return sorted(asked.intersection(machine.not_enforced))

    def _state_of(self, record: Environment) -> EnvironmentState:
        if not record.machine:
            return "waiting"
        if record.name in self.state.joined:
            return "ready" if self._readiness.is_ready(ref(record)) else "starting"
        return "away" if record.name in self.state.processes else "starting"

    def node(self, record: Node) -> NodeView:
        """Return the view of a node."""
        end = self.state.ends.get(record.key)
        if self._readiness.is_ready(ref(record)):
            return _node_view(record, "running", end)
        return _node_view(record, "waiting" if end and end.node == record else "starting", end)

    def ended_node(self, record: NodeEnd) -> NodeView:
        """Return the view of a node that has ended."""
        return _node_view(record.node, "ended", record)

    def parameter(self, record: Parameter) -> ParameterView:
        """Return the view of a parameter."""
        return ParameterView(*_parts(record.owner), record.node, record.name, record.value)

    def recorder(self, record: Recorder) -> RecorderView:
        """Return the view of a recorder."""
        ready = self._readiness.is_ready(ref(record))
        state: Literal["starting", "recording"] = "recording" if ready else "starting"
        return RecorderView(
            *_parts(record.owner), record.tag, state, record.topics, record.max_size, record.max_duration
        )

    def interface(self, record: Interface) -> InterfaceView:
        """Return the view of an interface."""
        return InterfaceView(
            *_parts(record.owner),
            record.tag,
            "ready" if self._readiness.is_ready(ref(record)) else "starting",
            record.kind,
            record.type,
            record.address,
            qos_message(record.qos),
            record.format,
            delivery_message(record.delivery),
            record.codec,
            self.state.connections.count(record.key),
            self.rates.get(record.key),
        )

    def connection(self, record: Connection) -> ConnectionView:
        """Return the view of a connection."""
        return ConnectionView(
            record.user,
            record.sender.removeprefix(f"{record.user}/"),
            record.receiver.removeprefix(f"{record.user}/"),
            "up" if record.link else "down",
            self.state.interfaces[record.sender].type,
            self.rates.get(record.key),
        )

    def process(self, record: Process) -> MachineView:
        """Return the view of a process."""
        name = record.name
        environments = self.state.environments.by(at(name)) if record.role == "container" else []
        measured = [self.usage[each.name] for each in environments if each.name in self.usage]
        return MachineView(
            name,
            record.role,  # type: ignore[arg-type]  # environments have views of their own
            "joined" if name in self.state.joined else "away" if name in self.state.expected else "gone",
            record.host,
            record.url,
            record.capacity,
            record.capacity - free_slots(self.state, record),
            record.gpus,
            record.gpus - free_gpus(self.state, record),
            record.features,
            len(environments),
            self.state.robots.count(at(name)) if record.role == "robot" else 0,
            Usage(sum(each.cores for each in measured), sum(each.memory for each in measured)) if measured else None,
            sorted(self._addresses(record)),
        )

    def _addresses(self, record: Process) -> set[str]:
        """Return the hosts by which the processes of a machine are reached."""
        same = [
            each for role in ROLES for each in self.state.processes.by(role) if record.host and each.host == record.host
        ]
        return {host for each in same or [record] for host in _hosts(each)}

    def groups(self, user: str) -> list[GroupView]:
        """Return the network groups of a user."""
        found = []
        for group, members in of_user(self.state, user).items():
            subnet = self.state.environments[next(iter(members))].subnet
            found.append(GroupView(user, group, subnet, {_parts(name)[1]: ip for name, ip in members.items()}))
        return found


def _hosts(record: Process) -> Iterator[str]:
    """Yield the hosts in the endpoint descriptions and the URL of a process."""
    for each in (*record.addresses, *(f"relay:{relay}" for relay in record.relays.values())):
        if match := _HOST.match(each):
            yield match[1]
    if host := urlsplit(record.url).hostname:
        yield host


def _parts(name: str) -> tuple[str, str]:
    user, _, tag = name.partition("/")
    return user, tag


def _node_view(
    record: Node, state: Literal["starting", "running", "waiting", "ended"], end: NodeEnd | None
) -> NodeView:
    return NodeView(
        *_parts(record.owner),
        record.tag,
        state,
        record.package,
        record.executable,
        record.arguments,
        record.name,
        record.namespace,
        record.restart,
        None if end is None else NodeEndView(end.time, end.status, signal_name(end.status), end.count, end.lines),
        record.launch,
        record.part_of,
    )


def signal_name(status: int) -> str:
    """Return the signal of an exit status, as SIGKILL; empty if none killed the program."""
    if status >= 0:
        return ""
    try:
        return signal.Signals(-status).name
    except ValueError:
        return f"signal {-status}"
