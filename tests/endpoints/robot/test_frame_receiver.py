"""Frames and blobs of one socket: how they are joined, passed on and rejected."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any, cast

import pytest
from msgspec import UNSET

from endpoints.robot.frame_receiver import LARGE, MAX_OTHER, FrameReceiver, ServerLimits
from endpoints.robot.intake import BAD_WINDOW
from endpoints.robot.session import RobotSession
from endpoints.robot.streams import Streams
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, NotFound, RceError
from rce.protocol.blobs import Buffer
from rce.protocol.messages import Ack, DataMessage, Frame, StatusData
from tests.support.hand_turned import HandTurnedLoop

BLOB = "0a" * 16


class FakeSession:
    """Session that records commands, and what is sent to the robot."""

    def __init__(self) -> None:
        self.features = frozenset({"ack"})
        self.parts = False
        self.streams = Streams("i")
        self.commands: list[str] = []
        self.refusal: RceError | None = None
        self.errors: list[tuple[RceError, Any]] = []
        self.acknowledged: list[Any] = []

    def command(self, frame: Frame) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.commands.append(frame.type)

    def pause_reading(self, until: asyncio.Future[None]) -> None:
        """Read on: no test sends too much."""

    def error(self, error: RceError, id: Any = UNSET) -> None:
        self.errors.append((error, id))

    def status(self, data: StatusData, id: Any = UNSET) -> None:
        assert isinstance(data, Ack)
        self.acknowledged.append(id)


class Socket:
    """A receiver, with its session and what it passes on."""

    def __init__(self, hand: HandTurnedLoop, **limits: Any) -> None:
        self.hand = hand
        self.session = FakeSession()
        self.handled: list[tuple[str, dict[str, bytes]]] = []
        self.refusal: RceError | None = None
        self.ends: list[str] = []
        session = cast(RobotSession, self.session)
        self.receiver = hand.do(lambda: FrameReceiver(session, ServerLimits(**limits), self._handle, self.ends.append))

    def _handle(self, session: RobotSession, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        assert cast(object, session) is self.session
        if self.refusal is not None:
            raise self.refusal
        self.handled.append((message.iTag, {name: bytes(blob) for name, blob in blobs.items()}))

    def text(self, frame: dict[str, Any] | str) -> None:
        payload = (frame if isinstance(frame, str) else json.dumps(frame)).encode()
        self.hand.do(lambda: self.receiver.text(payload))

    def binary(self, payload: bytes) -> None:
        self.hand.do(lambda: self.receiver.binary(payload))

    def sweep(self) -> None:
        self.hand.do(self.receiver.sweep)

    @property
    def errors(self) -> list[tuple[str, Any]]:
        """Codes of the errors that were sent to the robot, with the ids of the frames."""
        return [(error.info.code, None if id is UNSET else id) for error, id in self.session.errors]


@pytest.fixture
def make(hand: HandTurnedLoop) -> Callable[..., Socket]:
    return lambda **limits: Socket(hand, **limits)


@pytest.fixture
def socket(make: Callable[..., Socket]) -> Socket:
    return make()


def dm(id: object = None, **content: object) -> dict[str, Any]:
    data = {"iTag": "out", "type": "a/B", "msgID": "n", **(content or {"msg": {}})}
    return {"type": "DM", "data": data} | ({} if id is None else {"id": id})


def test_message_without_blobs_is_passed_on_at_once(socket: Socket) -> None:
    socket.text(dm())
    assert socket.handled == [("out", {})]
    assert socket.errors == []


@pytest.mark.parametrize("blob_first", [True, False])
def test_message_is_passed_on_with_its_blob(socket: Socket, blob_first: bool) -> None:
    steps: list[Callable[[], None]] = [
        lambda: socket.text(dm(**{"msg*": BLOB})),
        lambda: socket.binary(BLOB.encode() + b"pixels"),
    ]
    first, second = reversed(steps) if blob_first else steps
    first()
    assert socket.handled == []
    second()
    assert socket.handled == [("out", {BLOB: b"pixels"})]


def test_star_in_text_is_no_reference(socket: Socket) -> None:
    socket.text(dm(msg={"data": "2 * 3"}))
    assert socket.handled == [("out", {})]


def test_commands_go_to_the_session(socket: Socket) -> None:
    for kind in ("CC", "DC", "CN", "CX"):
        socket.text({"type": kind, "data": {}})
    assert socket.session.commands == ["CC", "DC", "CN", "CX"]
    socket.session.refusal = InvalidRequest("no")
    socket.text({"type": "CC", "data": {}, "id": 5})
    assert socket.errors == [("invalid_request", 5)]


def test_handled_message_is_acknowledged_if_it_has_an_id(socket: Socket) -> None:
    socket.text(dm(id=0))
    socket.text(dm())
    assert socket.session.acknowledged == [0]
    socket.session.features = frozenset()
    socket.text(dm(id=1))
    assert socket.session.acknowledged == [0], "the robot does not know acknowledgements"


def test_refused_message_is_rejected_with_its_interface_and_ids(socket: Socket) -> None:
    socket.refusal = NotFound("no such interface")
    socket.text(dm(id=7))
    ((error, id),) = socket.session.errors
    assert (error.info.fields["iTag"], error.info.fields["msgID"], id) == ("out", "n", 7)
    assert socket.session.acknowledged == []
    socket.session.features = frozenset()
    socket.text(dm(id=8))
    assert socket.errors[-1] == ("not_found", None)


def test_refused_message_with_blob_is_rejected_once(socket: Socket) -> None:
    socket.refusal = NotFound("no such interface")
    socket.text(dm(id=7, **{"msg*": BLOB}))
    socket.binary(BLOB.encode() + b"pixels")
    assert socket.errors == [("not_found", 7)]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"type": "DM", "data": {"iTag": 5}}', '{"type": "DM"}'])
def test_malformed_frame_is_rejected(socket: Socket, text: str) -> None:
    socket.text(text)
    assert (len(socket.errors), socket.handled, socket.ends) == (1, [], [])


def test_deeply_nested_frame_is_rejected(socket: Socket) -> None:
    socket.text('{"type": "DM", "data": ' + "[" * 100_000 + "]" * 100_000 + "}")
    assert [code for code, _ in socket.errors] == ["invalid_request"]


def test_malformed_blob_is_rejected(socket: Socket) -> None:
    socket.binary(b"short")
    assert socket.errors == [("invalid_request", None)]


def test_incomplete_messages_are_rejected_when_they_are_too_old(
    make: Callable[..., Socket], hand: HandTurnedLoop
) -> None:
    socket = make(blob_age=60.0)
    socket.text(dm(id="frame", **{"msg*": BLOB}))
    socket.binary(b"0b" * 16 + b"pixels")
    hand.turn(59)
    socket.sweep()
    assert socket.errors == []
    hand.turn(2)
    socket.sweep()
    assert sorted(id or "" for _, id in socket.errors) == ["", "frame"]
    socket.sweep()
    assert len(socket.errors) == 2


def test_oldest_incomplete_message_gives_way_when_there_are_too_many(make: Callable[..., Socket]) -> None:
    socket = make(blobs=2)
    for number in range(3):
        socket.text(dm(id=number, **{"msg*": f"{number:032x}"}))
    assert [id for _, id in socket.errors] == [0]
    socket.binary(f"{2:032x}".encode() + b"x")
    assert len(socket.handled) == 1


def test_socket_is_ended_after_too_many_bad_messages(make: Callable[..., Socket]) -> None:
    socket = make(bad_messages=3)
    for _ in range(3):
        socket.text("{")
    assert socket.ends == []
    socket.text("{")
    (reason,) = socket.ends
    assert reason.startswith("more than 3 bad messages within a minute; the last: ")


def test_bad_messages_are_forgotten_after_a_minute(make: Callable[..., Socket], hand: HandTurnedLoop) -> None:
    socket = make(bad_messages=3)
    for _ in range(10):
        socket.text("{")
        hand.turn(BAD_WINDOW / 3 + 0.1)
    assert (len(socket.errors), socket.ends) == (10, [])


def test_zero_bad_messages_means_no_limit(make: Callable[..., Socket]) -> None:
    socket = make(bad_messages=0)
    for _ in range(500):
        socket.text("{")
    assert (len(socket.errors), socket.ends) == (500, [])


def test_message_to_peer_that_is_gone_is_not_counted_as_bad(make: Callable[..., Socket]) -> None:
    socket = make(bad_messages=1)
    socket.refusal = NotConnected("the peer is gone")
    for _ in range(5):
        socket.text(dm())
    assert (len(socket.errors), socket.ends) == (5, [])


def test_numbered_message_is_passed_on_once_and_acknowledged_again(make: Callable[..., Socket]) -> None:
    socket = make()
    data = {"iTag": "out", "type": "std_msgs/String", "msgID": "nil", "msg": {"data": "x"}, "stream": "s", "number": 1}
    for frame_id in ("first", "again"):
        socket.text({"type": "DM", "id": frame_id, "data": data})
    assert socket.session.acknowledged == ["first", "again"]
    assert len(socket.handled) == 1
    socket.refusal = NotConnected("no peer")
    socket.text({"type": "DM", "id": "next", "data": data | {"number": 2}})
    socket.refusal = None
    socket.text({"type": "DM", "id": "repeated", "data": data | {"number": 2}})
    assert socket.session.acknowledged == ["first", "again", "repeated"]
    assert len(socket.handled) == 2
    socket.text({"type": "DM", "id": "long", "data": data | {"stream": "s" * 65}})
    assert socket.errors[-1] == ("invalid_request", "long")


def test_large_message_is_passed_on_without_decoding_its_content(socket: Socket) -> None:
    broken = json.dumps(dm(id=3, msg={"data": "x" * LARGE})).replace("x", "\x01")  # a converter refuses this
    socket.text(broken)
    assert socket.handled == [("out", {})]
    assert (socket.errors, socket.session.acknowledged) == ([], [3])


def test_large_message_with_blobs_is_decoded_as_a_whole(socket: Socket) -> None:
    socket.text(dm(msg={"data": "x" * LARGE, "pixels*": BLOB}))
    socket.binary(BLOB.encode() + b"pixels")
    assert socket.handled == [("out", {BLOB: b"pixels"})]


@pytest.mark.parametrize("frame", [{"type": "CN", "data": {}}, dm(msg={"pixels*": BLOB})])
def test_frame_that_would_take_long_to_decode_is_refused(socket: Socket, frame: dict[str, Any]) -> None:
    socket.text({"id": 5, **frame, "data": {**frame["data"], "padding": "x" * MAX_OTHER}})
    ((error, frame_id),) = socket.session.errors
    assert frame_id == 5
    assert isinstance(error, LimitExceeded)
    assert f"{MAX_OTHER}; send the large part as a blob" in str(error)
    assert (socket.handled, socket.session.commands) == ([], [])
    socket.text(dm())
    assert socket.handled == [("out", {})], "the next one is not disturbed"
