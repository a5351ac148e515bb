"""Gauges: rates and usage are measured while somebody watches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import pytest

from master.execution.dispatcher import Dispatcher
from master.execution.readiness import Readiness
from master.graph.records import Connection, Environment, EnvironmentOptions, Interface, Process, Robot
from master.graph.state import State
from master.live.gauges import PERIOD, Changed, Gauges
from master.live.presenter import Presenter
from rce.api.views import Rate
from rce.api.views import Usage as Shows
from rce.control.calls.call import Call
from rce.control.calls.watching import (
    Counts,
    CountTraffic,
    EnvironmentUsage,
    InterfaceTraffic,
    MeasureUsage,
    Traffic,
    Usage,
)
from rce.control.connection import Control
from rce.errors import Lost
from tests.support.hand_turned import HandTurnedLoop

OUT, IN = "aa" * 16, "bb" * 16


class Answering:
    """Control connection with fixed answers."""

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
    """Environment `map` of ann sends to her robot `r`; both endpoints and the machine answer."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        state = self.state = State()
        state.environments.put(Environment("ann/map", EnvironmentOptions(), "1" * 32, "m1"))
        state.robots.put(Robot("ann/r", "west", ""))
        state.processes.put(Process("m1", "container", "1", capacity=4))
        state.joined |= {"m1", "west", "ann/map"}
        for owner, tag, id in (("ann/map", "out", OUT), ("ann/r", "in", IN)):
            state.interfaces.put(Interface(id, owner, tag, "", "std_msgs/String"))
        state.connections.put(Connection("ann/map/out", "ann/r/in", "l"))
        dispatcher = Dispatcher()
        self.environment = Answering({CountTraffic: Traffic({})})
        self.robot = Answering({CountTraffic: Traffic({})})
        self.machine = Answering({MeasureUsage: Usage({})})
        self.processes = {"ann/map": self.environment, "west": self.robot, "m1": self.machine}
        dispatcher.controls = {name: cast(Control, each) for name, each in self.processes.items()}
        self.presenter = Presenter(state, Readiness())
        self.gauges = Gauges(state, dispatcher, self.presenter)
        self.told: list[Changed] = []
        self.passed(0, 0, 0)
        self.uses(0, 0)

    unheard = 0

    def passed(self, messages: int, size: int, drops: int) -> None:
        all_sent = InterfaceTraffic(Counts(messages, size, drops), Counts(), {IN: Counts(drops=drops)}, self.unheard)
        got = InterfaceTraffic(Counts(), Counts(messages - drops, size), {OUT: Counts(messages - drops, size)})
        self.environment.answers[CountTraffic] = Traffic({OUT: all_sent})
        self.robot.answers[CountTraffic] = Traffic({IN: got})

    def uses(self, seconds: float, memory: int) -> None:
        self.machine.answers[MeasureUsage] = Usage({"ann/map": EnvironmentUsage(seconds, memory)})

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


def test_rates_and_usage_are_differences_of_two_readings(world: World) -> None:
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    assert world.told == [{"interfaces": set(), "connections": set(), "environments": set(), "machines": set()}]
    assert world.presenter.rates == {}
    world.unheard = 7
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
    assert world.presenter.interface(world.state.interfaces["ann/map/out"]).rate == Rate(10, 1000, 6, 7)
    assert world.presenter.interface(world.state.interfaces["ann/r/in"]).rate == Rate(8, 1000, 0)
    assert world.presenter.connection(world.state.connections["ann/map/out ann/r/in"]).rate == Rate(8, 1000, 6)
    assert world.presenter.environment(world.state.environments["ann/map"]).usage == Shows(0.5, 5_000_000)
    assert world.presenter.process(world.state.processes["m1"]).usage == Shows(0.5, 5_000_000)


def test_unchanged_rates_are_not_reported(world: World) -> None:
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    for round in range(1, 4):
        world.unheard = 123_000 + round
        world.passed(15_000 * round + round % 2, 0, 0)  # a message more or less
        world.hand.turn(PERIOD)
    assert not any(world.told[-1].values())
    assert world.presenter.rates["ann/map/out"] == Rate(5000, 0, 0, 123_000)


def test_nothing_is_measured_without_watchers(world: World) -> None:
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
    assert world.presenter.usage == {}


def test_process_without_answer_or_after_restart_has_no_rates(world: World) -> None:
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    world.passed(20, 2000, 0)
    world.robot.answers[CountTraffic] = Lost("it went")
    world.hand.turn(PERIOD)
    assert set(world.presenter.rates) == {"ann/map/out"}
    world.passed(30, 3000, 0)
    world.hand.turn(PERIOD)
    assert set(world.presenter.rates) == {"ann/map/out"}, "what has come since is known after the next answer"
    world.passed(5, 100, 0)
    world.hand.turn(PERIOD)
    assert world.presenter.rates == {}
    world.passed(8, 250, 0)
    world.hand.turn(PERIOD)
    assert world.presenter.rates["ann/map/out"] == Rate(1, 50, 0)


def test_process_without_interfaces_is_not_asked(world: World) -> None:
    for key in ("ann/map/out", "ann/r/in"):
        world.state.interfaces.drop(key)
    world.state.connections.drop("ann/map/out ann/r/in")
    world.hand.do(lambda: world.gauges.watch(world.told.append))
    assert (world.environment.asked, world.robot.asked, world.machine.asked) == (0, 0, 1)
