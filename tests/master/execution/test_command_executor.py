"""Command executor: when a command is complete, and what is taken back when it fails."""

from __future__ import annotations

import asyncio

import pytest
import sqlalchemy as sa

from master.execution import command_executor
from master.execution.command_executor import COMMAND_TIMEOUT, START_TIMEOUT, START_TOGETHER
from master.graph import sessions
from master.graph.records import Parameter, Robot
from master.service import ASK_TIMEOUT
from master.storage import store
from rce.api.roles import Principal, Scopes
from rce.control.calls.endpoints import AddRoute, Bind, OpenLink, PutParameter, StartNode, StopNode, Unbind
from rce.control.calls.environments import StartEnvironment, StopEnvironment
from rce.control.calls.robots import DescribeType, Execute, Executed
from rce.errors import (
    AlreadyExists,
    Forbidden,
    InvalidRequest,
    LimitExceeded,
    NotFound,
    RceError,
    StartFailed,
    TimedOut,
    Unavailable,
    UnknownType,
)
from rce.protocol import messages as m
from tests.support.master.desk import Desk, Peer
from tests.support.master.fleet import interface
from tests.support.master.peers import Furnished


@pytest.fixture
def brain(desk: Desk) -> Peer:
    """Environment ann/brain on machine m1, and Robot endpoint west with ann/r1."""
    desk.robot()
    desk.machine("m1")
    return desk.made("brain")


def values(desk: Desk) -> dict[str, object]:
    return {parameter.name: parameter.value for parameter in desk.state.parameters}


# --- completion -------------------------------------------------------------------------------------------------------


def test_command_is_complete_when_its_process_has_answered(desk: Desk, brain: Peer) -> None:
    brain.held.add(StartNode)
    task = desk.do(m.AddNode("brain", "n", "p", "e"))
    assert not task.done()
    brain.release()
    assert task.result() is None


def test_command_of_an_environment_that_starts_is_complete_when_it_is_in_sync(desk: Desk) -> None:
    desk.machine("m1")
    task = desk.do(m.CreateContainer("brain"), m.SetParameter("brain", "rate", 1))
    assert not task.done()
    desk.endpoint("brain")
    assert task.result() is None


def test_refused_command_changes_nothing(desk: Desk, brain: Peer) -> None:
    assert isinstance(desk.do(m.CreateContainer("brain")).exception(), AlreadyExists)
    assert len(desk.state.environments) == 1


def test_environment_that_waits_for_room_starts_after_one_is_destroyed(desk: Desk) -> None:
    m1 = desk.machine("m1")
    desk.made("one", size=2)
    m1.leave()
    task = desk.do(m.CreateContainer("two", m.ContainerData(size=2)))
    assert task.exception() is not None  # no machine could ever take both
    m1 = desk.machine("m1", one=desk.run("one"))
    desk.do(m.DestroyContainer("one"))
    desk.do(m.CreateContainer("two", m.ContainerData(size=2)))
    assert [call.environment.name for call in m1.got(StartEnvironment)] == ["ann/two"]


def test_interface_is_added_although_the_connection_that_waited_for_it_cannot_be_opened(desk: Desk) -> None:
    west, brain = desk.wired()
    desk.hand.do(lambda: desk.master.process_tracker._lifecycle.apply(sessions.robot_left(desk.state, "ann/r1")))
    desk.state.robots.put(Robot("ann/r1", "west", "s"))
    west.refuse[OpenLink] = Unavailable("nothing listens there")
    assert desk.do(interface("r1", "pose", "SubscriberConverter")).result() is None
    assert "ann/r1/pose" in desk.state.interfaces
    assert [*desk.state.connections]
    assert len(brain.got(AddRoute)) == 2


# --- failures ---------------------------------------------------------------------------------------------------------


def test_node_that_cannot_start_is_removed_with_the_reason(desk: Desk, brain: Peer) -> None:
    error = brain.refuse[StartNode] = StartFailed("no executable e in p")
    assert desk.do(m.AddNode("brain", "n", "p", "e")).exception() is error
    assert len(desk.state.nodes) == 0
    assert brain.got(StopNode) == [StopNode("n")]


def test_interface_that_cannot_be_made_is_removed_with_the_reason(desk: Desk, brain: Peer) -> None:
    error = brain.refuse[Bind] = NotFound("type a/B does not exist")
    assert desk.do(interface("brain", "x", "PublisherInterface", "a/B")).exception() is error
    assert len(desk.state.interfaces) == 0
    assert len(brain.got(Unbind)) == 1


def test_environment_that_does_not_come_up_in_time_is_removed(desk: Desk) -> None:
    m1 = desk.machine("m1")
    task = desk.do(m.CreateContainer("brain"))
    desk.turn(START_TIMEOUT - 1)
    assert not task.done()
    desk.turn(1)
    assert isinstance(task.exception(), TimedOut)
    assert len(desk.state.environments) == 0
    assert m1.got(StopEnvironment) == [StopEnvironment("ann/brain")]


@pytest.mark.parametrize(
    "command",
    [
        m.CreateContainer("brain"),
        m.AddNode("brain", "n", "p", "e", existOk=True),
        m.AddRecorder("brain", "r", existOk=True),
        interface("brain", "x", "PublisherInterface", "a/B"),
        m.Connect("r1/x", "brain/x"),
    ],
    ids=lambda command: type(command).__name__,
)
def test_what_a_repeated_declaration_finds_is_kept_if_it_is_not_ready_in_time(desk: Desk, command: m.Command) -> None:
    desk.robot()
    m1 = desk.machine("m1")
    brain = desk.made("brain")
    desk.do(
        m.AddNode("brain", "n", "p", "e"),
        m.AddRecorder("brain", "r"),
        interface("r1", "x", "SubscriberConverter", "a/B"),
        interface("brain", "x", "PublisherInterface", "a/B"),
        m.Connect("r1/x", "brain/x"),
    )
    before = [[*table] for table in desk.state.tables()]
    brain.leave()
    m1.leave(silently=True)
    repeated = desk.hand.begin(desk.master.commands.execute("ann", command, repeated=True))
    if not repeated.done():
        desk.turn(START_TIMEOUT)
    assert [[*table] for table in desk.state.tables()] == before


def test_refused_value_of_a_new_parameter_is_removed(desk: Desk, brain: Peer) -> None:
    error = brain.refuse[PutParameter] = InvalidRequest("all items of a list must be of the same type")
    assert desk.do(m.SetParameter("brain", "rates", [1, "two"])).exception() is error
    assert values(desk) == {}


def test_refused_value_of_a_parameter_is_replaced_by_the_former_one(desk: Desk, brain: Peer) -> None:
    desk.do(m.SetParameter("brain", "rates", [1, 2]))
    error = brain.refuse[PutParameter] = InvalidRequest("all items of a list must be of the same type")
    assert desk.do(m.SetParameter("brain", "rates", [1, "two"])).exception() is error
    assert values(desk) == {"rates": [1, 2]}
    assert [call.parameter.value for call in brain.got(PutParameter)] == [[1, 2], [1, "two"], [1, 2]]


def test_later_value_of_a_parameter_outlasts_a_refused_one(desk: Desk, brain: Peer) -> None:
    brain.held.add(PutParameter)
    brain.refuse[PutParameter] = error = InvalidRequest("no")
    refused = desk.do(m.SetParameter("brain", "rate", 2**70))
    del brain.refuse[PutParameter]
    accepted = desk.do(m.SetParameter("brain", "rate", 3))
    brain.release()
    assert refused.exception() is error
    brain.release()
    assert accepted.result() is None
    assert values(desk) == {"rate": 3}
    assert brain.got(PutParameter)[-1].parameter.value == 3


def test_command_ends_without_an_error_if_a_later_one_removes_its_object(desk: Desk) -> None:
    desk.machine("m1")
    creating = desk.do(m.CreateContainer("brain"))
    desk.do(m.DestroyContainer("brain"))
    assert creating.result() is None


# --- commands of robots -----------------------------------------------------------------------------------------------


def frame(desk: Desk, *commands: m.Command, robot: str = "ann/r1", endpoint: str = "west") -> asyncio.Task[Executed]:
    """Begin the commands of a frame."""
    process = desk.state.processes[endpoint]
    return desk.hand.begin(desk.master.commands._by_robot(process, Execute.of(robot, *commands)))


def by_robot(desk: Desk, command: m.Command, robot: str = "ann/r1", endpoint: str = "west") -> RceError | None:
    executed = frame(desk, command, robot=robot, endpoint=endpoint).result()
    return RceError.from_info(executed.failed[0]) if executed.failed else None


def test_command_of_a_robot_changes_the_things_of_its_user(desk: Desk, brain: Peer) -> None:
    assert by_robot(desk, m.SetParameter("brain", "rate", 1)) is None
    assert list(desk.state.parameters) == [Parameter("ann/brain", "rate", 1)]


@pytest.mark.parametrize(("robot", "endpoint"), [("ann/r2", "west"), ("ann/r1", "m1")])
def test_command_of_a_robot_without_a_session_at_its_endpoint_is_refused(
    desk: Desk, brain: Peer, robot: str, endpoint: str
) -> None:
    task = frame(desk, m.SetParameter("brain", "rate", 1), robot=robot, endpoint=endpoint)
    assert isinstance(task.exception(), NotFound)
    assert values(desk) == {}


def test_failed_command_of_a_frame_does_not_stop_the_others(desk: Desk, brain: Peer) -> None:
    executed = frame(
        desk, m.SetParameter("brain", "a", 1), m.RemoveNode("brain", "none"), m.SetParameter("brain", "b", 2)
    ).result()
    assert {position: info.code for position, info in executed.failed.items()} == {1: "not_found"}
    assert values(desk) == {"a": 1, "b": 2}


async def test_commands_of_a_frame_are_stored_in_one_transaction(
    furnished: Furnished, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[int] = []
    put = store._put

    def counted(connection: sa.Connection, rows: dict[tuple[str, str], str | None]) -> None:
        written.append(len(rows))
        put(connection, rows)

    await furnished.platform.store.save(furnished.platform.master.state)
    monkeypatch.setattr(store, "_put", counted)
    commands = [m.SetParameter("brain", f"p{number}", number) for number in range(START_TOGETHER)]
    executed = await furnished.west.call(Execute.of("ann/r1", *commands))
    assert executed == Executed()
    assert written == [START_TOGETHER]


def test_frames_of_a_robot_are_executed_in_their_order(desk: Desk, brain: Peer) -> None:
    """Also if the first one is so long that others get a turn meanwhile."""
    long = [m.SetParameter("brain", "rate", number) for number in range(3 * START_TOGETHER)]
    first, second = frame(desk, *long), frame(desk, m.SetParameter("brain", "rate", -1))
    desk.hand.settle()
    assert [first.done(), second.done()] == [True, True]
    assert values(desk) == {"rate": -1}


def test_command_beyond_the_rights_of_the_robots_key_is_refused(desk: Desk, brain: Peer) -> None:
    tied = Principal("ann", "robot", "key", scopes=Scopes("r2", ["other"]))
    desk.state.robots.put(Robot("ann/r2", "west", "s", tied))
    assert isinstance(by_robot(desk, m.SetParameter("brain", "rate", 1), "ann/r2"), Forbidden | NotFound)
    assert values(desk) == {}


# --- deadlines --------------------------------------------------------------------------------------------------------


def test_command_ends_when_its_process_answers_pings_only(desk: Desk, brain: Peer) -> None:
    brain.held.add(StartNode)
    task = desk.do(m.AddNode("brain", "n", "p", "e"))
    desk.turn(StartNode.timeout - 1)
    assert not task.done()
    desk.turn(1)
    assert isinstance(task.exception(), TimedOut)
    assert len(desk.state.nodes) == 0
    assert brain.got(StopNode), "it may have started the node"


def test_commands_that_pile_up_at_one_thing_end_together(desk: Desk, brain: Peer) -> None:
    brain.held |= {StartNode, StopNode}
    tasks = [desk.do(m.AddNode("brain", "n", "p", "e"))]
    for _ in range(20):
        tasks += [desk.do(m.RemoveNode("brain", "n")), desk.do(m.AddNode("brain", "n", "p", "e"))]
    desk.turn(COMMAND_TIMEOUT)
    assert all(task.done() for task in tasks)
    assert {type(task.exception()) for task in tasks} <= {TimedOut, type(None)}
    for _ in range(100):
        desk.turn(StartNode.timeout)
    assert len(brain.got(StartNode)) == 21, "each call was made in its turn"


def test_removal_of_an_environment_does_not_wait_for_its_start(desk: Desk) -> None:
    """The start may hang; the machine cancels it when it gets the removal."""
    m1 = desk.machine("m1")
    m1.held.add(StartEnvironment)
    start = desk.do(m.CreateContainer("brain"))
    assert desk.do(m.DestroyContainer("brain")).result() is None
    assert [type(call) for call in m1.arrived[-2:]] == [StartEnvironment, StopEnvironment]
    m1.refuse[StartEnvironment] = StartFailed("cancelled")
    m1.release()
    assert start.done()
    assert len(desk.state.environments) == 0


def test_more_commands_than_a_user_may_have_in_progress_are_refused(
    desk: Desk, brain: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_executor, "MAX_COMMANDS", 3)
    brain.held.add(StartNode)
    tasks = [desk.do(m.AddNode("brain", f"n{number}", "p", "e")) for number in range(4)]
    assert [task.done() for task in tasks] == [False, False, False, True]
    assert isinstance(tasks[3].exception(), LimitExceeded)
    brain.release()
    assert desk.do(m.SetParameter("brain", "rate", 1)).result() is None
    desk.turn(StartNode.timeout)
    assert [type(task.exception()) for task in tasks[:3]] == [type(None), TimedOut, TimedOut]


def test_question_to_an_environment_that_does_not_answer_ends(desk: Desk, brain: Peer) -> None:
    brain.held.add(DescribeType)
    call = DescribeType("ann", "my_msgs/msg/A", "msg")
    asked = desk.hand.begin(desk.master.ask(desk.state.environments["ann/brain"], call))
    described = desk.hand.begin(desk.master.robot_questions.describe_type(call))
    desk.turn(ASK_TIMEOUT)
    assert isinstance(asked.exception(), TimedOut)
    assert isinstance(described.exception(), UnknownType)
