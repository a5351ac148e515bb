"""Rates and usage: asked for while somebody watches, shown with what they are of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import pytest
from hand_turned import HandTurnedLoop

from master.carrier import Carrier
from master.gauges import PERIOD, Changed, Gauges
from master.records import Connection, Environment, Interface, Process, Robot, State
from master.shown import Shown
from rce.calls.call import Call
from rce.calls.endpoints import InterfaceSpec
from rce.calls.watching import Counts, CountTraffic, InterfaceTraffic, MeasureUsage, Traffic, Usage, Used
from rce.control import Control
from rce.errors import Lost
from rce.messages import ContainerData
from rce.views import Rate
from rce.views import Usage as Shows

OUT, IN = "aa" * 16, "bb" * 16


class Answering:
    """Answers with what it is given."""

    def __init__(self, answers: dict[type[Call[Any]], Any]) -> None:
        self.answers = answers
        self.asked = 0

    async def call(self, call: Call[Any]) -> object:
        self.asked += 1
        answer = self.answers[type(call)]
        if isinstance(answer, Exception):
            raise answer
        return answer


class World:
    """ann's environment `map` sends to her robot `r`; both endpoints and the machine answer."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        state = self.state = State()
        state.environments.put(Environment("ann/map", ContainerData(), "1" * 32, "m1"))
        state.robots.put(Robot("ann/r", "west", ""))
        state.processes.put(Process("m1", "container", "1", capacity=4))
        state.joined |= {"m1", "west", "ann/map"}
        for owner, tag, id in (("ann/map", "out", OUT), ("ann/r", "in", IN)):
            state.interfaces.put(Interface(InterfaceSpec(id, owner, tag, "", "std_msgs/String")))
        state.connections.put(Connection("ann/map/out", "ann/r/in", "l"))
        carrier = Carrier(cast(Any, None), lambda send, answer: None)
        self.environment = Answering({CountTraffic: Traffic({})})
        self.robot = Answering({CountTraffic: Traffic({})})
        self.machine = Answering({MeasureUsage: Usage({})})
        self.processes = {"ann/map": self.environment, "west": self.robot, "m1": self.machine}
        carrier.controls = {name: cast(Control, each) for name, each in self.processes.items()}
        self.shown = Shown(state, lambda key: True)
        self.gauges = Gauges(state, carrier, self.shown)
        self.told: list[Changed] = []
        self.passed(0, 0, 0)
        self.uses(0, 0)

    def passed(self, messages: int, size: int, drops: int) -> None:
        all_sent = InterfaceTraffic(Counts(messages, size, drops), Counts(), {IN: Counts(drops=drops)})
        got = InterfaceTraffic(Counts(), Counts(messages - drops, size), {OUT: Counts(messages - drops, size)})
        self.environment.answers[CountTraffic] = Traffic({OUT: all_sent})
        self.robot.answers[CountTraffic] = Traffic({IN: got})

    def uses(self, seconds: float, memory: int) -> None:
        self.machine.answers[MeasureUsage] = Usage({"ann/map": Used(seconds, memory)})

    @property
    def asked(self) -> int:
        return sum(each.asked for each in self.processes.values())


@pytest.fixture
def world() -> Iterator[World]:
    hand = HandTurnedLoop()
    world = World(hand)
    yield world
    hand.do(world.gauges.close)
    hand.settle()
    hand.close()


def test_rates_and_usage_are_those_between_two_answers(world: World) -> None:
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    assert world.told == [{"interfaces": set(), "connections": set(), "environments": set(), "machines": set()}]
    assert world.shown.rates == {}
    world.passed(30, 3000, 6)
    world.uses(1.5, 5_000_000)
    world.hand.turn(PERIOD)
    assert world.told[1:] == [
        {
            "interfaces": {"ann/map/out", "ann/r/in"},
            "connections": {"ann/map/out ann/r/in"},
            "environments": {"ann/map"},
            "machines": {"m1"},
        }
    ]
    assert world.shown.interface(world.state.interfaces["ann/map/out"]).rate == Rate(10, 1000, 6)
    assert world.shown.interface(world.state.interfaces["ann/r/in"]).rate == Rate(8, 1000, 0)
    assert world.shown.connection(world.state.connections["ann/map/out ann/r/in"]).rate == Rate(8, 1000, 6)
    assert world.shown.environment(world.state.environments["ann/map"]).usage == Shows(0.5, 5_000_000)
    assert world.shown.process(world.state.processes["m1"]).usage == Shows(0.5, 5_000_000)


def test_what_stays_the_same_is_not_told_anew(world: World) -> None:
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    for round in range(1, 4):
        world.passed(15_000 * round + round % 2, 0, 0)  # a message more or less
        world.hand.turn(PERIOD)
    assert not any(world.told[-1].values())
    assert world.shown.rates["ann/map/out"] == Rate(5000, 0, 0)


def test_nobody_is_asked_while_nobody_watches(world: World) -> None:
    world.hand.turn(60)
    assert world.asked == 0
    leave = [world.hand.do(lambda: world.gauges.watch(world.told.append)) for _ in range(2)]
    world.hand.turn(PERIOD)
    assert world.asked == 6, "two rounds of three, however many watch"
    world.hand.do(leave[0])
    world.hand.turn(PERIOD)
    assert world.asked == 9
    world.hand.do(leave[1])
    world.hand.turn(60)
    assert world.asked == 9
    assert world.shown.usage == {}


def test_a_process_that_does_not_answer_or_began_anew_has_no_figures(world: World) -> None:
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    world.passed(20, 2000, 0)
    world.robot.answers[CountTraffic] = Lost("it went")
    world.hand.turn(PERIOD)
    assert set(world.shown.rates) == {"ann/map/out"}
    world.passed(30, 3000, 0)
    world.hand.turn(PERIOD)
    assert set(world.shown.rates) == {"ann/map/out"}, "what has come since is known after the next answer"
    world.passed(5, 100, 0)
    world.hand.turn(PERIOD)
    assert world.shown.rates == {}
    world.passed(8, 250, 0)
    world.hand.turn(PERIOD)
    assert world.shown.rates["ann/map/out"] == Rate(1, 50, 0)


def test_who_has_no_interface_is_not_asked(world: World) -> None:
    for key in ("ann/map/out", "ann/r/in"):
        world.state.interfaces.drop(key)
    world.state.connections.drop("ann/map/out ann/r/in")
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    assert (world.environment.asked, world.robot.asked, world.machine.asked) == (0, 0, 1)
