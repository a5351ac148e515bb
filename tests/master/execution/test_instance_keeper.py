"""The instance keeper: instances by load, and the end of those that are idle."""

from __future__ import annotations

from master.execution.instance_keeper import INTERVAL, InstanceKeeper
from master.graph import catalogue
from master.graph.limits import Policy
from rce.control.calls.environments import StartEnvironment, StopEnvironment
from rce.protocol import messages as m
from tests.support.master.desk import Desk
from tests.support.master.fleet import numbers
from tests.support.master.offers import declared


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def keeper(desk: Desk, clock: Clock, policy: Policy | None = None) -> InstanceKeeper:
    return InstanceKeeper(desk.master._runner, desk.master._lifecycle, lambda _: policy or Policy(), clock)


def test_lower_bound_is_kept_running(desk: Desk) -> None:
    machine, clock = desk.machine("m1"), Clock()
    catalogue.publish(desk.state, "ann", declared(least=2), numbers())
    keep = keeper(desk, clock)
    desk.hand.do(keep.check)
    desk.turn(0.1)
    assert {call.environment.name for call in machine.got(StartEnvironment)} == {"ann/parrot_1", "ann/parrot_2"}
    desk.hand.do(lambda: catalogue.scale(desk.state, desk.state.offers["ann/parrot"], 1, 2))
    for clock.now in (INTERVAL, INTERVAL + 11.0):
        desk.hand.do(keep.check)
    desk.turn(0.1)
    assert [call.name for call in machine.got(StopEnvironment)] == ["ann/parrot_1"]


def test_instance_is_idle_only_while_no_robot_takes_part(desk: Desk) -> None:
    desk.machine("m1")
    desk.robot()
    clock = Clock()
    catalogue.publish(desk.state, "ann", declared(), numbers())
    keep = keeper(desk, clock)
    desk.hand.do(keep.check)
    desk.hand.begin(desk.master.commands.execute("ann", m.UseService("parrot"), robot="r1"))
    desk.endpoint("parrot_1")
    for clock.now in (1.0, 100.0):
        desk.hand.do(keep.check)
    assert "ann/parrot_1" in desk.state.environments
    desk.hand.begin(desk.master.commands.execute("ann", m.LeaveService("parrot"), robot="r1"))
    for clock.now in (101.0, 110.9):
        desk.hand.do(keep.check)
    assert "ann/parrot_1" in desk.state.environments
    clock.now = 111.0
    desk.hand.do(keep.check)
    assert "ann/parrot_1" not in desk.state.environments


def test_limits_of_the_publisher_hold(desk: Desk) -> None:
    desk.machine("m1")
    catalogue.publish(desk.state, "ann", declared(least=2), numbers())
    keep = keeper(desk, Clock(), Policy(environments=1))
    for _ in range(2):
        desk.hand.do(keep.check)
    assert [each.environment for each in desk.state.instances] == ["ann/parrot_1"]
