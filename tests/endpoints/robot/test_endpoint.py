"""Robots' sessions: login, grace time and end, and the calls of the Master, with a fake of the Master."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any, cast

import msgspec
import pytest

from endpoints.data.port import DataPort
from endpoints.robot.endpoint import EXPIRY_RETRY, LoginResult, Options, RobotEndpoint
from endpoints.robot.frame_receiver import ServerLimits
from endpoints.robot.handshake import LoginRequest
from endpoints.robot.session import Piece, RobotSession
from rce.control.calls.call import Call
from rce.control.calls.endpoints import Bind, InterfaceSpec, LinkLost, Sync
from rce.control.calls.robots import (
    Definitions,
    DescribeType,
    DropRobot,
    LoggedIn,
    Login,
    SendStatus,
    SessionExpired,
    SocketStatus,
)
from rce.control.client import ControlClient
from rce.errors import NotFound, Unauthorized, Unavailable
from rce.protocol.messages import DataMessage, InterfaceStatus, NodeEvent
from tests.support.control import answer
from tests.support.hand_turned import HandTurnedLoop

GRACE = 10.0
NAME = "ann/r"
TAG = InterfaceSpec("0a" * 16, NAME, "in", "PublisherConverter", "std_msgs/String")


class FakeMaster:
    """Master that records the calls, and answers or refuses them as the test says."""

    def __init__(self) -> None:
        self.calls: list[Call[Any]] = []
        self.refusals: dict[type[Call[Any]], Exception] = {}
        self.login = LoggedIn("token", False)
        self.login_takes = 0.0  # seconds

    async def call(self, call: Call[Any], wait: float = 10.0) -> Any:
        self.calls.append(call)
        if type(call) in self.refusals:
            raise self.refusals[type(call)]
        if isinstance(call, Login):
            await asyncio.sleep(self.login_takes)
            return self.login
        return Definitions({"mine/msg/Thing": "int32 a"}) if isinstance(call, DescribeType) else None

    def of(self, kind: type[Call[Any]]) -> list[Any]:
        return [call for call in self.calls if type(call) is kind]


class Socket:
    """Socket that records what the robot gets."""

    part = 1000

    def __init__(self) -> None:
        self.frames: list[Any] = []
        self.ended = ""

    def write(self, piece: Piece) -> bool:
        self.frames += [msgspec.json.decode(cast(bytes, frame)) for frame in piece]
        return True

    def pause_reading(self, until: asyncio.Future[None]) -> None: ...

    def end(self, reason: str) -> None:
        self.ended = reason


class Trial:
    """A Robot endpoint on a loop whose time the test turns."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.master = FakeMaster()
        self.endpoint = hand.do(lambda: RobotEndpoint(DataPort(), Options(ServerLimits(), GRACE, 30.0)))
        self.endpoint.master = cast(ControlClient, self.master)
        self.handlers = self.endpoint.handlers()

    def log_in(self, features: str = "", resume: str = "") -> asyncio.Task[LoginResult]:
        request = LoginRequest("ann", "r", "secret", frozenset(features.split()), resume, False, "tcp4:1.2.3.4", "ann")
        return self.hand.begin(self.endpoint.login(request))

    def connect(self, features: str = "", token: str = "token") -> tuple[RobotSession, Socket]:
        """Log the robot in and open its socket."""
        self.master.login = LoggedIn(token, bool(self.endpoint.sessions))
        session, socket = self.log_in(features).result().session, Socket()
        self.hand.do(lambda: session.attach(socket, token, False, GRACE))
        self.hand.do(lambda: self.endpoint.connected(session))
        return session, socket

    def lose(self, session: RobotSession, socket: Socket) -> None:
        session.detach(socket)
        self.hand.do(lambda: self.endpoint.disconnected(session))

    def call(self, call: Call[Any]) -> Any:
        """Answer a call of the Master; raise the error of a call that fails."""
        return self.hand.begin(answer(self.handlers, call)).result()


@pytest.fixture
def trial(hand: HandTurnedLoop) -> Iterator[Trial]:
    yield Trial(hand)
    hand.turn(100)  # let grace times pass


def test_robot_is_logged_in_by_master(trial: Trial) -> None:
    result = trial.log_in("ack resume").result()
    assert (result.token, result.resumed, result.session.name) == ("token", False, NAME)
    assert result.session.features == {"ack", "resume"}
    (call,) = trial.master.of(Login)
    assert (call.user, call.robot, call.secret, call.owner) == ("ann", "r", "secret", "ann")
    assert (call.features, call.address) == (["ack", "resume"], "tcp4:1.2.3.4")


def test_refused_robot_has_no_session(trial: Trial) -> None:
    trial.master.refusals[Login] = Unauthorized("wrong password")
    assert isinstance(trial.log_in().exception(), Unauthorized)
    assert trial.endpoint.sessions == {}


def test_resumed_session_is_kept_and_another_one_is_replaced(trial: Trial) -> None:
    session, socket = trial.connect("resume")
    trial.lose(session, socket)
    trial.master.login = LoggedIn("second", True)
    assert trial.log_in(resume="token").result().session is session
    trial.master.login = LoggedIn("third", False)
    other = trial.log_in().result().session
    assert other is not session
    assert trial.endpoint.sessions == {NAME: other}


def test_robot_is_away_while_it_has_no_socket(trial: Trial) -> None:
    session, socket = trial.connect()
    assert trial.endpoint.report_away() == []
    trial.lose(session, socket)
    assert trial.endpoint.report_away() == [NAME]


def test_loss_of_a_socket_and_its_successor_are_reported(trial: Trial) -> None:
    session, socket = trial.connect()
    assert trial.master.of(SocketStatus) == []  # the login says it
    trial.lose(session, socket)
    trial.connect()
    assert [call.connected for call in trial.master.of(SocketStatus)] == [False, True]
    trial.connect()
    assert len(trial.master.of(SocketStatus)) == 2


def test_socket_that_opens_after_a_hello_without_it_is_reported(trial: Trial) -> None:
    session = trial.log_in().result().session
    assert trial.endpoint.report_away() == [NAME]
    trial.hand.do(lambda: trial.endpoint.connected(session))
    assert [call.connected for call in trial.master.of(SocketStatus)] == [True]


def test_socket_lost_during_a_login_does_not_leave_its_robot_away(trial: Trial) -> None:
    session, socket = trial.connect()
    trial.master.login, trial.master.login_takes = LoggedIn("second", False), 1.0
    login = trial.log_in()
    trial.lose(session, socket)  # this report reaches the Master after the login
    trial.hand.turn(2)
    fresh = login.result().session
    trial.hand.do(lambda: trial.endpoint.connected(fresh))
    assert [call.connected for call in trial.master.of(SocketStatus)] == [False, True]


def test_session_without_socket_ends_after_grace_time(trial: Trial) -> None:
    session, socket = trial.connect()
    trial.lose(session, socket)
    trial.hand.turn(GRACE - 1)
    assert trial.endpoint.sessions == {NAME: session}
    trial.hand.turn(2)
    assert trial.endpoint.sessions == {}
    assert trial.master.of(SessionExpired) == [SessionExpired(NAME)]


def test_robot_that_leaves_before_its_socket_is_open_loses_its_session(trial: Trial) -> None:
    session = trial.log_in().result().session
    trial.hand.do(lambda: trial.endpoint.disconnected(session))
    trial.hand.turn(GRACE + 1)
    assert trial.endpoint.sessions == {}


def test_session_of_bound_interface_ends_if_its_robot_does_not_come(trial: Trial) -> None:
    trial.call(Bind(TAG))
    trial.hand.turn(GRACE + 1)
    assert trial.endpoint.sessions == {}


def test_robot_that_comes_back_keeps_its_session(trial: Trial) -> None:
    session, socket = trial.connect("resume")
    trial.lose(session, socket)
    trial.hand.turn(GRACE - 1)
    again, _ = trial.connect("resume", "second")
    trial.hand.turn(GRACE * 2)
    assert again is session
    assert trial.endpoint.sessions == {NAME: session}
    assert trial.master.of(SessionExpired) == []


def test_refused_login_does_not_prolong_grace_time(trial: Trial) -> None:
    session, socket = trial.connect()
    trial.lose(session, socket)
    trial.hand.turn(GRACE - 1)
    trial.master.refusals[Login] = Unauthorized("wrong password")
    assert trial.log_in().exception()
    assert trial.endpoint.sessions == {NAME: session}
    trial.hand.turn(2)
    assert trial.endpoint.sessions == {}


def test_end_of_session_is_repeated_until_master_is_back(trial: Trial) -> None:
    session, socket = trial.connect()
    trial.lose(session, socket)
    trial.master.refusals[SessionExpired] = Unavailable("away")
    trial.hand.turn(GRACE + 2.5 * EXPIRY_RETRY)
    assert (trial.endpoint.sessions, len(trial.master.of(SessionExpired))) == ({NAME: session}, 3)
    trial.master.refusals.clear()
    trial.hand.turn(EXPIRY_RETRY)
    assert trial.endpoint.sessions == {}


def test_login_waits_for_end_of_old_session(trial: Trial) -> None:
    session, socket = trial.connect()
    trial.lose(session, socket)
    trial.master.refusals[SessionExpired] = Unavailable("away")
    trial.hand.turn(GRACE + 0.5)
    login = trial.log_in()
    assert not login.done()
    trial.master.refusals.clear()
    trial.master.login = LoggedIn("second", False)
    trial.hand.turn(EXPIRY_RETRY)
    assert login.result().session is not session


def test_finished_session_ends_at_once(trial: Trial) -> None:
    session, socket = trial.connect("resume")
    session.detach(socket)
    trial.hand.do(lambda: trial.endpoint.finished(session))
    assert trial.endpoint.sessions == {}
    assert trial.master.of(SessionExpired) == [SessionExpired(NAME)]


def test_streams_are_kept_of_robots_that_have_sent_numbered_messages(trial: Trial) -> None:
    def streams_of_an_ended_session(*numbers: int) -> Any:
        session, socket = trial.connect()
        for number in numbers:
            session.streams.begin(DataMessage("out", "std_msgs/String", "m", stream="s", number=number))
        trial.lose(session, socket)
        trial.call(DropRobot(NAME, "it left"))
        return trial.endpoint._streams.get(NAME)

    assert streams_of_an_ended_session() is None
    kept = streams_of_an_ended_session(1)
    assert kept is not None
    assert streams_of_an_ended_session() is kept


def test_unreported_status_does_no_harm(trial: Trial) -> None:
    trial.master.refusals[SocketStatus] = Unavailable("away")
    session, socket = trial.connect()
    trial.lose(session, socket)
    assert trial.endpoint.sessions == {NAME: session}
    assert len(trial.master.of(SocketStatus)) == 1


def test_data_for_unknown_interface_is_refused(trial: Trial) -> None:
    session, _ = trial.connect()
    with pytest.raises(NotFound, match="add it first"):
        trial.endpoint.data(session, DataMessage("none", "std_msgs/String", "n"), {})


def test_interface_is_bound_before_login_is_answered(trial: Trial) -> None:
    trial.call(Bind(TAG))
    bound = trial.endpoint.sessions[NAME]
    assert list(bound.interfaces) == ["in"]
    assert trial.log_in().result().session is bound


def test_definition_of_own_type_is_requested_from_master(trial: Trial) -> None:
    trial.connect()
    trial.call(Bind(msgspec.structs.replace(TAG, type="mine/Thing")))
    assert trial.master.of(DescribeType) == [DescribeType("ann", "mine/msg/Thing", "msg")]


def test_dropped_robot_gets_reason_and_loses_its_interfaces(trial: Trial) -> None:
    _, socket = trial.connect()
    trial.call(Bind(TAG))
    for _ in range(2):
        trial.call(DropRobot(NAME, "the password was changed"))
    assert socket.ended == "the password was changed"
    assert (trial.endpoint.sessions, trial.endpoint.switchboard.interfaces) == ({}, {})


def test_status_goes_to_robot_and_its_error_only_with_events(trial: Trial) -> None:
    session, socket = trial.connect("events")
    socket.frames.clear()
    call = SendStatus([NAME], InterfaceStatus("in", True), NotFound("lost").info)
    trial.call(call)
    assert [frame["type"] for frame in socket.frames] == ["ST", "ER"]
    session.features = frozenset()
    trial.call(call)
    trial.call(SendStatus([NAME], NodeEvent("sky", "brain", 1, [])))
    assert [frame["type"] for frame in socket.frames] == ["ST", "ER", "ST"]
    trial.call(SendStatus(["ann/unknown"], InterfaceStatus("in", True)))


def test_sync_ends_sessions_and_interfaces_that_master_does_not_have(trial: Trial) -> None:
    session, socket = trial.connect()
    trial.call(Bind(TAG))
    trial.call(Sync(interfaces=[TAG], robots=[NAME]))
    assert (trial.endpoint.sessions, list(session.interfaces)) == ({NAME: session}, ["in"])
    trial.call(Sync())
    assert (trial.endpoint.sessions, socket.ended) == ({}, "the session has ended")
    assert trial.endpoint.switchboard.interfaces == {}


def test_lost_link_is_reported(trial: Trial) -> None:
    trial.hand.do(lambda: trial.endpoint.switchboard._link_lost("link", "broken"))
    assert trial.master.of(LinkLost) == [LinkLost("link", "broken")]


def test_sessions_are_counted_by_state(trial: Trial) -> None:
    session, socket = trial.connect()
    trial.lose(session, socket)
    session.interface_status("in", True)  # waits for the next socket
    (sessions, queued, _) = trial.endpoint._families()
    assert {tuple(each.labels): each.value for each in sessions.samples} == {("connected",): 0, ("away",): 1}
    assert [each.value for each in queued.samples] == [1]
