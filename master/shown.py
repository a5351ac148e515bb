"""The records as the API and the feed show them."""

from __future__ import annotations

from collections.abc import Callable

from master.groups import of_user
from master.placement import free_gpus, free_slots
from master.records import Connection, Environment, Interface, Node, Parameter, Process, Robot, State, at, what
from rce.names import is_guest
from rce.views import (
    ConnectionView,
    EnvironmentView,
    GroupView,
    InterfaceView,
    MachineView,
    NodeView,
    ParameterView,
    Rate,
    RobotView,
    Usage,
)
from rce.views.resources import EnvironmentState


class Shown:
    """`is_real` tells of what a record names whether it is there. What was measured last stands in `rates`, by the keys
    of interfaces and connections, and in `usage`, by those of environments; who measures fills them.
    """

    def __init__(self, state: State, is_real: Callable[[str], bool]) -> None:
        self.state = state
        self.rates: dict[str, Rate] = {}
        self.usage: dict[str, Usage] = {}
        self._is_real = is_real

    def robot(self, record: Robot) -> RobotView:
        user, tag = _parts(record.name)
        return RobotView(
            user,
            tag,
            "connected" if record.endpoint in self.state.joined and record.name not in self.state.away else "away",
            record.endpoint,
            len(self.state.interfaces.by(record.name)),
            record.by.user if is_guest(tag) else "",
        )

    def environment(self, record: Environment) -> EnvironmentView:
        name = record.name
        state = self.state
        return EnvironmentView(
            *_parts(name),
            self._state_of(record),
            record.machine,
            record.options,
            record.address,
            record.egress,
            record.packages,
            len(state.nodes.by(name)),
            len(state.parameters.by(name)),
            len(state.interfaces.by(name)),
            self.usage.get(name),
        )

    def _state_of(self, record: Environment) -> EnvironmentState:
        if not record.machine:
            return "waiting"
        if record.name in self.state.joined:
            return "ready" if self._is_real(what(record)) else "starting"
        return "away" if record.name in self.state.processes else "starting"

    def node(self, record: Node) -> NodeView:
        spec = record.spec
        return NodeView(
            *_parts(record.owner),
            spec.tag,
            "running" if self._is_real(what(record)) else "starting",
            spec.pkg,
            spec.exe,
            spec.args,
            spec.name,
            spec.namespace,
        )

    def parameter(self, record: Parameter) -> ParameterView:
        return ParameterView(*_parts(record.owner), record.spec.node, record.spec.name, record.spec.value)

    def interface(self, record: Interface) -> InterfaceView:
        spec = record.spec
        return InterfaceView(
            *_parts(spec.owner),
            spec.tag,
            "ready" if self._is_real(what(record)) else "starting",
            spec.kind,
            spec.type,
            spec.addr,
            spec.qos,
            spec.format,
            len(self.state.connections.by(record.key)),
            self.rates.get(record.key),
        )

    def connection(self, record: Connection) -> ConnectionView:
        user, sender = _parts(record.sender)
        return ConnectionView(
            user,
            sender,
            _parts(record.receiver)[1],
            "up" if record.link else "down",
            self.state.interfaces[record.sender].spec.type,
            self.rates.get(record.key),
        )

    def process(self, record: Process) -> MachineView:
        name = record.name
        environments = self.state.environments.by(at(name)) if record.role == "container" else []
        measured = [self.usage[each.name] for each in environments if each.name in self.usage]
        return MachineView(
            name,
            record.role,  # type: ignore[arg-type]  # environments are shown as such
            "joined" if name in self.state.joined else "away" if name in self.state.expected else "gone",
            record.host,
            record.url,
            record.capacity,
            record.capacity - free_slots(self.state, record),
            record.gpus,
            record.gpus - free_gpus(self.state, record),
            record.features,
            len(environments),
            len(self.state.robots.by(at(name))) if record.role == "robot" else 0,
            Usage(sum(each.cores for each in measured), sum(each.memory for each in measured)) if measured else None,
        )

    def groups(self, user: str) -> list[GroupView]:
        """The network groups of a user."""
        found = []
        for group, members in of_user(self.state, user).items():
            subnet = self.state.environments[next(iter(members))].subnet
            found.append(GroupView(user, group, subnet, {_parts(name)[1]: ip for name, ip in members.items()}))
        return found


def _parts(name: str) -> tuple[str, str]:
    user, _, tag = name.partition("/")
    return user, tag
