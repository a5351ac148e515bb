"""Interface of an environment that offers an action to nodes; its peer, a robot, carries out the goals."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Time
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.serialization import deserialize_message, serialize_message

from endpoints.data.frames import Buffer, Message, Phase
from endpoints.data.goals import MAX_GOALS
from endpoints.data.interface import error_of
from endpoints.data.link import Link
from endpoints.environment.interfaces import RosContext, RosInterface, as_bytes
from endpoints.environment.ros_actions import FEEDBACK_QOS, STATUS_QOS, part_of, with_goal_id, without_goal_id
from endpoints.environment.ros_services import Header, RawService, ServiceType
from endpoints.environment.ros_types import action_class
from endpoints.environment.service_calls import TIMEOUT
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import LimitExceeded, NotConnected, RceError, TimedOut

KEPT = 900.0  # seconds for which the result of a goal is kept
ENDS = {
    Phase.SUCCEEDED: GoalStatus.STATUS_SUCCEEDED,
    Phase.CANCELED: GoalStatus.STATUS_CANCELED,
    Phase.ABORTED: GoalStatus.STATUS_ABORTED,
}
CANCELABLE = (GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)


@dataclass(eq=False)
class _Cancellation:
    """A request of a node to cancel goals: those whose answer is missing, and those that will be canceled."""

    header: Header
    until: float
    pending: set[str]
    accepted: list[str] = field(default_factory=list)


@dataclass(eq=False)
class _Goal:
    """A goal of a node. `until` is when it must be accepted and, once it has ended, when its result is forgotten."""

    request: Header | None
    until: float
    stamp: Time
    status: int = GoalStatus.STATUS_UNKNOWN
    waiting: list[Header] = field(default_factory=list)  # requests for the result
    result: bytes = b""  # once it has ended


class ActionProviderInterface(RosInterface):
    """Offers an action to nodes. A goal is aborted when the peer is gone; what fails is reported to the owner."""

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context)
        self._goals: dict[str, _Goal] = {}
        self._cancellations: list[_Cancellation] = []

    async def open(self) -> None:
        """Create the ROS entities; the publisher of the status is the last, since clients see the server by it."""
        kind = action_class(self.spec.type, self._context.definitions)
        self._create(lambda: self._create_entities(kind))

    def _create_entities(self, kind: type[Any]) -> None:
        ros, impl, action = self._ros, kind.Impl, self.spec.addr
        self._kind = kind

        def service(kind: ServiceType, part: str, requested: Callable[[Header, bytes], None]) -> RawService:
            return RawService(ros, kind, part_of(action, part), requested, self._report_from_ros)

        self._send_goal = service(impl.SendGoalService, "send_goal", self._goal_requested)
        self._get_result = service(impl.GetResultService, "get_result", self._result_requested)
        self._cancel_goal = service(CancelGoal, "cancel_goal", self._cancel_requested)
        create = ros.node.create_publisher
        self._feedback = create(impl.FeedbackMessage, part_of(action, "feedback"), FEEDBACK_QOS)
        self._status = create(GoalStatusArray, part_of(action, "status"), STATUS_QOS)
        self._publish_status()

    def _ask(self, id: str, phase: Phase, payload: bytes = b"") -> None:
        """Send a message to the peer."""
        message = Message(self.id, id, payload, phase=phase)
        try:
            self.request(message)
        except (NotConnected, LimitExceeded) as error:
            self._goal_failed(error)
            self._refused(id, phase)

    def _goal_failed(self, error: RceError) -> None:
        self._report_once(type(error)(f"interface {self.spec.tag}: a goal of {self.spec.addr} failed: {error}"))

    # requests of nodes

    def _goal_requested(self, header: Header, payload: bytes) -> None:
        id, goal = without_goal_id(payload)
        unfinished = sum(not each.result for each in self._goals.values())
        if id in self._goals or unfinished >= MAX_GOALS:
            self._answer_goal(header, accepted=False)
            return
        stamp = self._ros.node.get_clock().now().to_msg()
        self._goals[id] = _Goal(header, time.monotonic() + TIMEOUT, stamp)
        self._ask(id, Phase.GOAL, goal)

    def _answer_goal(self, header: Header, *, accepted: bool, stamp: Time | None = None) -> None:
        response = self._kind.Impl.SendGoalService.Response(accepted=accepted, stamp=stamp or Time())
        self._send_goal.answer(header, serialize_message(response))

    def _result_requested(self, header: Header, payload: bytes) -> None:
        goal = self._goals.get(without_goal_id(payload)[0])
        if goal is None:
            self._get_result.answer(header, self._response(GoalStatus.STATUS_UNKNOWN))
        elif goal.result:
            self._get_result.answer(header, goal.result)
        else:
            goal.waiting.append(header)

    def _response(self, status: int, payload: Buffer = b"") -> bytes:
        """Return the response with a result; an empty one is the default."""
        response = self._kind.Impl.GetResultService.Response(status=status)
        if payload:
            response.result = deserialize_message(as_bytes(payload), self._kind.Result)
        return serialize_message(response)

    def _cancel_requested(self, header: Header, payload: bytes) -> None:
        info = deserialize_message(payload, CancelGoal.Request).goal_info
        id, before = bytes(info.goal_id.uuid).hex(), (info.stamp.sec, info.stamp.nanosec)
        named = id if id.strip("0") else ""
        chosen = {
            key
            for key, goal in self._goals.items()
            if goal.status in CANCELABLE
            and (key == named or (goal.stamp.sec, goal.stamp.nanosec) <= before or not (named or any(before)))
        }
        if chosen:
            self._cancellations.append(_Cancellation(header, time.monotonic() + TIMEOUT, set(chosen)))
            for key in chosen:
                self._ask(key, Phase.CANCEL)
            return
        code = CancelGoal.Response.ERROR_NONE
        if named:
            known = named in self._goals and self._goals[named].result
            code = CancelGoal.Response.ERROR_GOAL_TERMINATED if known else CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
        self._cancel_goal.answer(header, serialize_message(CancelGoal.Response(return_code=code)))

    # answers of the peer

    def receive(self, message: Message, link: Link) -> None:
        """Pass on what became of a goal."""
        id, phase = message.msg_id, message.phase
        goal = self._goals.get(id)
        if goal is None or goal.result:
            return  # it was given up
        if message.error and phase != Phase.CANCEL:
            error = error_of(message)
            self._goal_failed(error)
            self._refused(id, Phase.GOAL)
        elif phase == Phase.CANCEL:
            self._cancel_answered(id, accepted=not message.error)
        elif phase == Phase.REJECTED:
            self._refused(id, Phase.GOAL)
        elif phase == Phase.FEEDBACK:
            self._feedback.handle.publish_raw(with_goal_id(message.payload, id))
        elif phase == Phase.ACCEPTED:
            self._accept(goal)
        elif phase in ENDS:
            self._accept(goal)
            self._end(id, goal, phase, message.payload)
        self.hops.delivered(self.id, message)

    def _accept(self, goal: _Goal) -> None:
        if goal.request is not None:
            self._answer_goal(goal.request, accepted=True, stamp=goal.stamp)
            goal.request, goal.status = None, GoalStatus.STATUS_EXECUTING
            self._publish_status()

    def _refused(self, id: str, phase: Phase) -> None:
        """Handle that the peer does not do what it was asked: reject or abort the goal, or refuse to cancel it."""
        goal = self._goals.get(id)
        if phase == Phase.CANCEL:
            self._cancel_answered(id, accepted=False)
        elif goal is not None and goal.request is not None:
            self._answer_goal(goal.request, accepted=False)
            del self._goals[id]
        elif goal is not None and not goal.result:
            self._end(id, goal, Phase.ABORTED)

    def _end(self, id: str, goal: _Goal, phase: Phase, payload: Buffer = b"") -> None:
        try:
            goal.result = self._response(ENDS[phase], payload)
        except _rclpy.RMWError as error:
            reason = f"the result is not a serialized {self.spec.type} result: {error}"
            self._report_from_ros(RceError, reason)
            phase = Phase.ABORTED
            goal.result = self._response(ENDS[phase])
        goal.status, goal.until = ENDS[phase], time.monotonic() + KEPT
        for header in goal.waiting:
            self._get_result.answer(header, goal.result)
        goal.waiting.clear()
        self._answer_cancels(id, accepted=phase == Phase.CANCELED)  # that the peer has not answered
        self._publish_status()

    def _cancel_answered(self, id: str, *, accepted: bool) -> None:
        if accepted and (goal := self._goals.get(id)) is not None:
            goal.status = GoalStatus.STATUS_CANCELING
            self._publish_status()
        self._answer_cancels(id, accepted=accepted)

    def _answer_cancels(self, id: str, *, accepted: bool) -> None:
        for each in [each for each in self._cancellations if id in each.pending]:
            each.pending.discard(id)
            if accepted:
                each.accepted.append(id)
            if not each.pending:
                self._answer_cancel(each)

    def _answer_cancel(self, cancellation: _Cancellation) -> None:
        self._cancellations.remove(cancellation)
        infos = [_info(id, self._goals[id].stamp) for id in cancellation.accepted if id in self._goals]
        code = CancelGoal.Response.ERROR_NONE if infos else CancelGoal.Response.ERROR_REJECTED
        response = CancelGoal.Response(return_code=code, goals_canceling=infos)
        self._cancel_goal.answer(cancellation.header, serialize_message(response))

    def _publish_status(self) -> None:
        known = [(id, goal) for id, goal in self._goals.items() if goal.request is None]
        statuses = [GoalStatus(goal_info=_info(id, goal.stamp), status=goal.status) for id, goal in known]
        self._status.publish(GoalStatusArray(status_list=statuses))

    # ends

    def tick(self, now: float) -> None:
        """End what has timed out, and forget old results."""
        late = [
            (id, goal)
            for id, goal in self._goals.items()
            if goal.until < now and (goal.request is not None or goal.result)
        ]
        for id, goal in late:
            if goal.request is not None:
                self._ask(id, Phase.CANCEL)
                self._refused(id, Phase.GOAL)
                self._report_from_ros(TimedOut, f"a goal of {self.spec.addr} was not accepted within {TIMEOUT:g} s")
            else:
                del self._goals[id]
        if late:
            self._publish_status()
        for each in [each for each in self._cancellations if each.until < now]:
            self._answer_cancel(each)

    def stopped(self) -> None:
        """Abort the goals of the peer that is gone."""
        running = [id for id, goal in self._goals.items() if not goal.result]
        for id in running:
            self._refused(id, Phase.GOAL)
        if running:
            self._report_from_ros(NotConnected, f"the connection ended with {len(running)} goals unfinished")

    def close(self) -> None:
        """Destroy the ROS entities."""
        for service in (self._send_goal, self._get_result, self._cancel_goal):
            service.destroy()
        for publisher in (self._feedback, self._status):
            self._ros.node.destroy_publisher(publisher)


def _info(id: str, stamp: Time) -> GoalInfo:
    info = GoalInfo(stamp=stamp)
    info.goal_id.uuid = list(bytes.fromhex(id))
    return info
