"""A small platform in memory for the tests of the graph: its state, numbers for ids, and short ways to say commands."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from master import graph, presence
from master.effects import Outcome, Plan, Send
from master.policies import UNLIMITED
from master.records import Process, Robot, Role, State
from rce import messages as m
from rce.calls.call import Call
from rce.calls.joining import Hello


def numbers() -> Callable[[], str]:
    """Ids that tell their order; the number stands in front because names of links keep eight digits."""
    count = itertools.count(1)
    return lambda: f"{next(count):08x}{'0' * 24}"


class Fleet:
    """The graph of a platform, and who has joined it."""

    def __init__(self) -> None:
        self.state = State()
        self.ids = numbers()
        self.policy = UNLIMITED

    def join(self, name: str, role: Role, incarnation: str = "1", **hello: Any) -> Plan:
        said = Hello(role, name, "", "", incarnation, **hello)
        process = Process(
            name, role, incarnation, said.host, said.addresses, said.url, said.capacity, said.features, said.gpus
        )
        return presence.joined(self.state, process, said, self.ids)

    def do(self, user: str, command: m.Command, again: bool = False, guest: str = "") -> Outcome:
        return graph.execute(self.state, user, command, self.ids, again, self.policy, guest)

    def robot(self, name: str, endpoint: str = "west", session: str = "s", resume: str = "") -> tuple[Outcome, bool]:
        return presence.robot_arrived(self.state, Robot(name, endpoint, session), resume, self.ids, self.policy)


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
    """The calls of a plan in the order of its text, those to one process if `to` is given."""
    return [send.call for send in sends(plan) if to is None or send.to == to]


def everything(state: State) -> dict[str, object]:
    """All records by kind and key, to compare."""
    return {f"{table.kind.__name__} {record.key}": record for table in state.tables() for record in table}
