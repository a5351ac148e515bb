"""Interface of an environment that sends the goals of its peers to an action server."""

from __future__ import annotations

from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.serialization import deserialize_message, serialize_message

from endpoints.data.frames import Message, Phase
from endpoints.data.goals import Goals
from endpoints.data.link import Link
from endpoints.environment.interfaces import RosContext, RosInterface
from endpoints.environment.ros_actions import (
    FEEDBACK_QOS,
    HEADER,
    STATUS_QOS,
    ActionTopic,
    part_of,
    with_goal_id,
    without_goal_id,
)
from endpoints.environment.ros_types import action_class
from endpoints.environment.service_calls import ServiceCall, ServiceCaller
from endpoints.environment.service_slots import MAX_IN_FLIGHT
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import Forbidden, Lost, NotFound, RceError

ENDS = {
    GoalStatus.STATUS_SUCCEEDED: Phase.SUCCEEDED,
    GoalStatus.STATUS_CANCELED: Phase.CANCELED,
    GoalStatus.STATUS_ABORTED: Phase.ABORTED,
}
RESULT_PATIENCE = 1.0  # seconds after its request in which the result of a goal that has ended comes


class ActionClientInterface(RosInterface):
    """Sends goals to an action server. The result is requested at once, without a timeout, and kept.

    ROS servers lose requests when more than 10 wait. So a result is requested again when the server's status says that
    the goal has ended, but no result has come.
    """

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context)
        self._goals = Goals(self, self._start, self._cancel)
        self._servers: dict[str, frozenset[bytes]] = {}  # of goals that were accepted: who may have accepted them
        self._results: dict[str, ServiceCall] = {}
        self._status = b""  # the newest status of the server's goals

    async def open(self) -> None:
        """Create the ROS entities."""
        kind = action_class(self.spec.type, self._context.definitions)
        self._create(lambda: self._create_entities(kind))

    def _create_entities(self, kind: type[Any]) -> None:
        ros, impl, action = self._ros, kind.Impl, self.spec.addr
        self._kind = kind
        goals, results, cancels = (part_of(action, part) for part in ("send_goal", "get_result", "cancel_goal"))
        slots = self._context.slots.of
        self._send_goal = ServiceCaller(ros, impl.SendGoalService, goals, self._label, slots(goals))
        self._get_result = ServiceCaller(ros, impl.GetResultService, results, self._label, None)
        self._cancel_goal = ServiceCaller(ros, CancelGoal, cancels, self._label, slots(cancels))
        feedback, status = part_of(action, "feedback"), part_of(action, "status")
        self._feedback = ActionTopic(ros, impl.FeedbackMessage, feedback, FEEDBACK_QOS, self._received_feedback)
        self._statuses = ActionTopic(ros, GoalStatusArray, status, STATUS_QOS, self._received_status)

    @property
    def _label(self) -> str:
        return f"interface {self.spec.tag}: action {self.spec.addr}"

    def receive(self, message: Message, link: Link) -> None:
        """Start or cancel a goal, or return its result."""
        self._goals.receive(message)

    def left(self, peer: bytes) -> None:
        """Cancel the goals of the peer that shall not outlive it."""
        self._goals.left(peer)

    def tick(self, now: float) -> None:
        """End calls that have timed out, and the goals of servers that are gone."""
        self._send_goal.expire(now)
        self._cancel_goal.expire(now)
        present = self._present_servers() if self._servers else frozenset()
        for id, servers in list(self._servers.items()):
            if not servers:
                self._servers[id] = present
            elif not servers & present:
                self._forget(id)
                self._fail(id, Lost(f"{self._label}: the server is gone, and its goal is aborted"))

        for id in self._overdue(now)[:MAX_IN_FLIGHT]:
            self._get_result.forget(self._results[id])
            self._request_result(id)

    def close(self) -> None:
        """Destroy the ROS entities. Goals go on in the server."""
        self._goals.close()
        for caller in (self._send_goal, self._get_result, self._cancel_goal):
            caller.destroy()
        for topic in (self._feedback, self._statuses):
            topic.destroy()

    def _start(self, message: Message) -> None:
        call = ServiceCall(
            with_goal_id(message.payload, message.msg_id),
            partial(self._goal_answered, message.msg_id),
            lambda: self.hops.delivered(self.id, message),
        )
        self._send_goal.call(call)

    def _goal_answered(self, id: str, answer: bytes | RceError) -> None:
        if isinstance(answer, RceError):
            self._fail(id, answer)
        elif not answer[4]:
            self._goals.answer(id, Phase.REJECTED)
        else:
            self._servers[id] = self._present_servers()
            self._goals.answer(id, Phase.ACCEPTED)
            self._request_result(id)

    def _request_result(self, id: str) -> None:
        call = self._results[id] = ServiceCall(HEADER + bytes.fromhex(id), partial(self._ended, id))
        self._get_result.call(call)

    def _received_feedback(self, payload: bytes) -> None:
        id, feedback = without_goal_id(payload)
        if id in self._goals:  # not of another client
            self._goals.answer(id, Phase.FEEDBACK, feedback)

    def _received_status(self, payload: bytes) -> None:
        self._status = payload

    def _ended(self, id: str, answer: bytes | RceError) -> None:
        self._feedback.take_all()  # the server sent it before the result
        self._forget(id)
        if isinstance(answer, RceError):
            self._fail(id, answer)
            return
        response = deserialize_message(answer, self._kind.Impl.GetResultService.Response)
        phase = ENDS.get(response.status)
        if phase is None:
            self._fail(id, NotFound(f"{self._label}: the server does not know the goal any more"))
            return
        result = serialize_message(response.result)
        self._goals.answer(id, phase, result)

    def _cancel(self, id: str) -> None:
        # A time of 0 means: this goal only.
        request = HEADER + bytes.fromhex(id) + bytes(8)
        self._cancel_goal.call(ServiceCall(request, partial(self._cancel_answered, id)))

    def _cancel_answered(self, id: str, answer: bytes | RceError) -> None:
        if not isinstance(answer, RceError):
            response = deserialize_message(answer, CancelGoal.Response)
            if not response.return_code and response.goals_canceling:
                self._goals.answer(id, Phase.CANCEL)
                return
            answer = Forbidden(f"{self._label}: the server does not cancel this goal")
        error = answer
        self._goals.not_canceled(id, error)

    def _overdue(self, now: float) -> list[str]:
        """Return the goals that have ended, but whose result has not come though it was requested a while ago."""
        waiting = {id for id, call in self._results.items() if call.since + RESULT_PATIENCE < now}
        if not waiting or not self._status:
            return []
        known = deserialize_message(self._status, GoalStatusArray).status_list
        ended = {bytes(each.goal_info.goal_id.uuid).hex() for each in known if each.status in ENDS}
        return sorted(waiting & ended)

    def _present_servers(self) -> frozenset[bytes]:
        """Return the identities of the servers, those of their publishers: a restarted server has another."""
        infos = self._ros.node.get_publishers_info_by_topic(part_of(self.spec.addr, "status"))
        return frozenset(bytes(info.endpoint_gid) for info in infos)

    def _forget(self, id: str) -> None:
        self._servers.pop(id, None)
        if (call := self._results.pop(id, None)) is not None:
            self._get_result.forget(call)

    def _fail(self, id: str, error: RceError) -> None:
        self._goals.fail(id, error)
