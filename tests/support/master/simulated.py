"""Processes in memory that take the calls of plans, in any order that the dispatcher allows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from master.graph.effects import Plan, Send
from master.graph.records import Ref
from rce.control.calls.call import Call
from rce.control.calls.endpoints import (
    AddRoute,
    Bind,
    CloseLink,
    DropParameter,
    InterfaceSpec,
    NodeSpec,
    OpenLink,
    ParameterSpec,
    PutParameter,
    RecorderSpec,
    RemoveRoute,
    StartNode,
    StartRecorder,
    StopNode,
    StopRecorder,
    Sync,
    Unbind,
)
from rce.control.calls.environments import KeepEnvironments, SetRelays, StartEnvironment, StopEnvironment
from rce.control.calls.robots import DropRobot, SendStatus


class Refused(Exception):
    """A process refuses a call: the sequence ends here."""


@dataclass
class Endpoint:
    """Robot endpoint or Environment endpoint, in the state that the calls made; every call is idempotent."""

    name: str
    incarnation: str
    robots: set[str] = field(default_factory=set)
    interfaces: dict[str, InterfaceSpec] = field(default_factory=dict)
    links: set[str] = field(default_factory=set)
    routes: dict[tuple[str, str], str] = field(default_factory=dict)
    nodes: dict[str, NodeSpec] = field(default_factory=dict)
    parameters: dict[str, ParameterSpec] = field(default_factory=dict)
    recorders: dict[str, RecorderSpec] = field(default_factory=dict)

    def take(self, call: Call[Any]) -> None:
        match call:
            case Sync():
                self._sync(call)
            case Bind(spec):
                self.interfaces[spec.id] = spec
            case Unbind(id):
                self._unbind(id)
            case OpenLink(link):
                self.links.add(link.name)
            case CloseLink(name):
                self.links.discard(name)
            case AddRoute(route):
                if route.link not in self.links or route.interface not in self.interfaces:
                    raise Refused(f"{self.name} cannot route {route}")
                self.routes[route.interface, route.peer] = route.link
            case RemoveRoute(interface, peer):
                self.routes.pop((interface, peer), None)
            case StartNode(node):
                self.nodes.setdefault(node.tag, node)
            case StopNode(tag):
                self.nodes.pop(tag, None)
            case PutParameter(parameter):
                self.parameters[parameter.key] = parameter
            case DropParameter(key):
                self.parameters.pop(key, None)
            case StartRecorder(recorder):
                self.recorders[recorder.tag] = recorder
            case StopRecorder(tag):
                self.recorders.pop(tag, None)
            case DropRobot(robot):
                self.drop_robot(robot)
            case SendStatus():
                pass
            case _:
                raise AssertionError(f"{call} at an endpoint")

    def _sync(self, sync: Sync) -> None:
        self.interfaces = {spec.id: spec for spec in sync.interfaces}
        self.links = {link.name for link in sync.links}
        self.routes = {(route.interface, route.peer): route.link for route in sync.routes}
        assert set(self.routes.values()) <= self.links
        assert {interface for interface, _ in self.routes} <= set(self.interfaces)
        self.nodes = {node.tag: node for node in sync.nodes}
        self.parameters = {parameter.key: parameter for parameter in sync.parameters}
        self.recorders = {recorder.tag: recorder for recorder in sync.recorders}
        self.robots &= set(sync.robots)

    def _unbind(self, id: str) -> None:
        self.interfaces.pop(id, None)
        self.routes = {pair: link for pair, link in self.routes.items() if pair[0] != id}

    def drop_robot(self, robot: str) -> None:
        self.robots.discard(robot)
        for spec in list(self.interfaces.values()):
            if spec.owner == robot:
                self._unbind(spec.id)


@dataclass
class TaskSet:
    """Task set: starts and stops environments; `ended` is called with name and run of a stopped one."""

    name: str
    ended: Callable[[str, str], None]
    runs: dict[str, str] = field(default_factory=dict)

    def take(self, call: Call[Any]) -> None:
        match call:
            case StartEnvironment(spec):
                if self.runs.get(spec.name) != spec.run:
                    self._end(spec.name)
                    self.runs[spec.name] = spec.run
            case StopEnvironment(name):
                self._end(name)
            case SetRelays():
                pass
            case KeepEnvironments(runs):
                for name in [name for name, run in self.runs.items() if run not in runs]:
                    self._end(name)
            case _:
                raise AssertionError(f"{call} at a task set")

    def _end(self, name: str) -> None:
        if run := self.runs.pop(name, None):
            self.ended(name, run)


@dataclass
class _Step:
    send: Send
    connection: int  # over which it goes; 0 for none
    before: list[_Step]
    done: bool = False


class Delivery:
    """Plans that run, in the order of the dispatcher: calls about one thing in order, others in any order.

    `connections` has the number of each process's connection.
    """

    def __init__(self, connections: dict[str, int]) -> None:
        self.connections = connections
        self.sequences: list[list[_Step]] = []
        self._tails: dict[tuple[str, Ref | None], _Step] = {}

    def add(self, plan: Plan) -> list[_Step]:
        added = []
        for steps in plan:
            sequence = []
            for send in steps:
                if isinstance(send, Send):
                    keys = {(send.to, send.about), (send.to, None)}
                    before = [self._tails[key] for key in keys if key in self._tails]
                    step = _Step(send, self.connections.get(send.to, 0), before)
                    self._tails[send.to, send.about] = step
                    sequence.append(step)
            if sequence:
                self.sequences.append(sequence)
                added += sequence
        return added

    def runnable(self) -> list[int]:
        return [index for index, sequence in enumerate(self.sequences) if all(step.done for step in sequence[0].before)]

    def run(self, index: int, carry: Callable[[Send], None]) -> None:
        """Run the next step of a sequence; Refused ends the sequence."""
        sequence = self.sequences[index]
        step = sequence.pop(0)
        step.done = True
        try:
            if step.connection and self.connections.get(step.send.to) == step.connection:
                carry(step.send)
        except Refused:
            for rest in sequence:
                rest.done = True
            sequence.clear()
        self.sequences = [each for each in self.sequences if each]
