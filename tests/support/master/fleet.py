"""A small platform in memory for tests of the graph: its state, numbered ids, and short forms of commands."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from master.graph import reconcile, sessions
from master.graph.commands import CommandContext, execute
from master.graph.effects import Outcome, Plan, Send
from master.graph.limits import UNLIMITED
from master.graph.records import Ref, Robot, Role, ref
from master.graph.state import State
from rce.api.roles import Principal
from rce.control.calls.call import Call
from rce.control.calls.joining import Hello
from rce.protocol import messages as m


def numbers() -> Callable[[], str]:
    """Return a source of ids in ascending order; the number comes first because names of links keep eight digits."""
    count = itertools.count(1)
    return lambda: f"{next(count):08x}{'0' * 24}"


class Fleet:
    """State of a platform, and operations on it."""

    def __init__(self) -> None:
        self.state = State()
        self.ids = numbers()
        self.policy = UNLIMITED

    def join(self, name: str, role: Role, incarnation: str = "1", **hello: Any) -> Plan:
        said = Hello(role, name, "", "", incarnation, **hello)
        process = reconcile.process_of(self.state, said)
        if role == "environment":
            process = replace(process, incarnation=incarnation)
        return reconcile.joined(self.state, process, said, self.ids)

    def do(self, user: str, command: m.Command, again: bool = False, robot: str = "") -> Outcome:
        return execute(CommandContext(self.state, user, self.ids, self.policy, again, robot), command)

    def robot(
        self, name: str, endpoint: str = "west", session: str = "s", resume: str = "", by: str = ""
    ) -> tuple[Outcome, bool]:
        robot = Robot(name, endpoint, session, Principal(by, "user") if by else None)
        return sessions.robot_arrived(self.state, robot, resume, self.ids, self.policy)


def furnished() -> Fleet:
    """Robot endpoint `west` with ann/r1 and bob/r1, machine `m1` with ann/brain, which has joined."""
    fleet = Fleet()
    fleet.join("west", "robot", host="h1", addresses=["unix:/w", "tcp:w:1"])
    fleet.join("m1", "container", capacity=4)
    fleet.robot("ann/r1")
    fleet.robot("bob/r1")
    fleet.do("ann", m.CreateContainer("brain"))
    fleet.join("ann/brain", "environment", host="h2")
    return fleet


def wired() -> Fleet:
    """`furnished`, with ann's r1/pose connected to brain/pose."""
    fleet = furnished()
    fleet.do("ann", interface("r1", "pose", "SubscriberConverter"))
    fleet.do("ann", interface("brain", "pose", "PublisherInterface"))
    fleet.do("ann", m.Connect("r1/pose", "brain/pose"))
    return fleet


def full() -> Fleet:
    """`wired`, with a node, a parameter, and further interfaces, of which a service is connected."""
    fleet = wired()
    for command in (
        m.AddNode("brain", "there", "p", "e"),
        m.SetParameter("brain", "rate", 1),
        interface("brain", "scans", "SubscriberInterface"),
        interface("brain", "number", "PublisherInterface", "std_msgs/Int32"),
        interface("brain", "answer", "ServiceClientInterface", "std_srvs/Empty"),
        interface("brain", "answer2", "ServiceClientInterface", "std_srvs/Empty"),
        interface("r1", "ask", "ServiceProviderConverter", "std_srvs/Empty"),
        m.Connect("r1/ask", "brain/answer"),
    ):
        fleet.do("ann", command)
    return fleet


def interface(owner: str, tag: str, kind: str, type: str = "std_msgs/String", **more: Any) -> m.AddInterface:
    return m.AddInterface(owner, tag, kind, type, **more)


def sends(plan: Plan) -> list[Send]:
    return [step for steps in plan for step in steps if isinstance(step, Send)]


def calls(plan: Plan, to: str | None = None) -> list[Call[Any]]:
    """Return the calls of a plan in order; only those to one process if `to` is given."""
    return [send.call for send in sends(plan) if to is None or send.to == to]


def everything(state: State) -> dict[Ref, object]:
    """Return all records by reference, for comparison."""
    return {ref(record): record for table in state.tables() for record in table}
