"""Flows of actions: the robot's for nodes of the environment, and the environment's for nodes of the robot."""

from __future__ import annotations

import asyncio
import uuid
from typing import Any

import msgspec

from endpoints.bridge.config import RosAction
from endpoints.bridge.flow import Flow
from endpoints.bridge.local_ros import CLOUD, LocalRos
from endpoints.data.frames import Message, Phase
from endpoints.data.interface import error_of
from endpoints.environment.action_client import ActionClientInterface
from endpoints.environment.action_provider import ActionProviderInterface
from endpoints.environment.service_calls import TIMEOUT
from rce.client import Environment
from rce.client.actions import Goal, GoalResult, ServerGoal
from rce.errors import Forbidden, RceError
from rce.net.outbox import Owner
from rce.protocol.blobs import Buffer
from rce.protocol.messages import GoalStatus

ENDS: dict[GoalStatus, Phase] = {
    "succeeded": Phase.SUCCEEDED,
    "canceled": Phase.CANCELED,
    "aborted": Phase.ABORTED,
}
STATUSES = {phase: status for status, phase in ENDS.items()}


class _RobotGoal:
    """A goal that an action server of the robot carries out. `feedback` passes on what the server tells."""

    def __init__(self) -> None:
        loop = asyncio.get_running_loop()
        self.id = uuid.uuid4().hex
        self.feedback: Any = None
        self.accepted: asyncio.Future[bool] = loop.create_future()
        self.ended: asyncio.Future[GoalResult] = loop.create_future()

    def told(self, message: Message) -> None:
        """Take note of what the server says."""
        phase = message.phase
        if phase == Phase.CANCEL:
            return  # whether it is canceled, its end tells
        if message.error:
            self.fail(error_of(message))
        elif phase == Phase.FEEDBACK:
            if self.feedback is not None:
                self.feedback(bytes(message.payload))
        elif phase in (Phase.ACCEPTED, Phase.REJECTED):
            _settle(self.accepted, phase == Phase.ACCEPTED)
        elif phase in STATUSES:
            _settle(self.accepted, True)
            _settle(self.ended, GoalResult(STATUSES[phase], bytes(message.payload)))

    def fail(self, error: RceError) -> None:
        """End the goal with an error, or reject it."""
        for future in (self.accepted, self.ended):
            if not future.done():
                future.set_exception(error)
                future.exception()  # it need not be read: the other one has it too


def _settle(future: asyncio.Future[Any], value: Any) -> None:
    if not future.done():
        future.set_result(value)


class OfferedAction(Flow):
    """An action of the robot that nodes of the environment may use."""

    def __init__(self, action: RosAction) -> None:
        super().__init__()
        self._action = action
        self._goals: dict[str, _RobotGoal] = {}
        self._begun: dict[int, _RobotGoal] = {}  # accepted, by the identity of the request, until it is carried out

    async def open(self, local: LocalRos, environment: Environment) -> None:
        """Create the interfaces at both ends."""
        action = self._action
        await self.add_local_interface(local, ActionClientInterface, action.type, action.action)
        name = action.to or action.action
        await environment.action_server(name, action.type, self._carry_out, accept=self._begin, raw=True)

    async def _begin(self, request: Buffer) -> bool:
        """Send a goal to the robot's server; return whether it accepts it."""
        goal = _RobotGoal()
        self._goals[goal.id] = goal
        goal.ended.add_done_callback(lambda _: self._goals.pop(goal.id, None))
        self.deliver(Message(CLOUD, goal.id, request, phase=Phase.GOAL))
        try:
            accepted = await asyncio.shield(goal.accepted)
        except asyncio.CancelledError:
            self._cancel(goal)
            raise
        if accepted:
            self._begun[id(request)] = goal
        else:
            del self._goals[goal.id]
        return accepted

    async def _carry_out(self, asked: ServerGoal) -> GoalResult:
        goal = self._begun.pop(id(asked.request))
        goal.feedback = asked.publish_feedback
        try:
            return await asyncio.shield(goal.ended)
        except asyncio.CancelledError:
            if not asked.canceled:
                raise  # the bridge ends
            self._cancel(goal)
            return await goal.ended

    def _cancel(self, goal: _RobotGoal) -> None:
        self.deliver(Message(CLOUD, goal.id, b"", phase=Phase.CANCEL))

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Pass on what the robot's server says about a goal."""
        goal = self._goals.get(message.msg_id)
        if goal is not None:
            goal.told(message)
        return 0

    def end(self) -> None:
        """Cancel the goals that shall not go on, and remove the interface."""
        if self._action.cancel_if_lost:
            for goal in list(self._goals.values()):
                self._cancel(goal)
        super().end()


class CalledAction(Flow):
    """An action of the environment that nodes of the robot may use."""

    def __init__(self, action: RosAction) -> None:
        super().__init__()
        self._action = action
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._goals: dict[str, Goal] = {}
        self._cancels: set[asyncio.Task[None]] = set()

    async def open(self, local: LocalRos, environment: Environment) -> None:
        """Create the interfaces at both ends."""
        action = self._action
        self._client = await environment.action_client(action.action, action.type, raw=True)
        name = action.to or action.action
        await self.add_local_interface(local, ActionProviderInterface, action.type, name)

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Send a goal of a node of the robot to the environment, or cancel it."""
        id = message.msg_id
        if message.phase == Phase.GOAL:
            task = self._tasks[id] = asyncio.create_task(self._ask(id, bytes(message.payload)))
            task.add_done_callback(lambda _: self._forget(id))
        elif message.phase == Phase.CANCEL:
            if id in self._goals:
                cancel = asyncio.create_task(self._cancel(id, self._goals[id]))
                self._cancels.add(cancel)
                cancel.add_done_callback(self._cancels.discard)
            elif id in self._tasks:  # it was not accepted in time
                self._tasks[id].cancel()
        return 0

    async def _ask(self, id: str, request: bytes) -> None:
        try:
            goal = await self._client.send_goal(request, timeout=TIMEOUT, cancel_if_lost=self._action.cancel_if_lost)
            self._goals[id] = goal
            self.deliver(Message(CLOUD, id, b"", phase=Phase.ACCEPTED))
            async for feedback in goal:
                self.deliver(Message(CLOUD, id, feedback, phase=Phase.FEEDBACK))
            result = await goal.result()
        except Forbidden:
            self.deliver(Message(CLOUD, id, b"", phase=Phase.REJECTED))
        except RceError as error:
            self._fail(id, error)
        else:
            self.deliver(Message(CLOUD, id, result.value, phase=ENDS[result.status]))

    async def _cancel(self, id: str, goal: Goal) -> None:
        try:
            await goal.cancel(TIMEOUT)
        except RceError as error:
            self._fail(id, error, Phase.CANCEL)
        else:
            self.deliver(Message(CLOUD, id, b"", phase=Phase.CANCEL))

    def _fail(self, id: str, error: RceError, phase: Phase = Phase.NONE) -> None:
        self.deliver(Message(CLOUD, id, msgspec.msgpack.encode(error.info), error=True, phase=phase))

    def _forget(self, id: str) -> None:
        self._tasks.pop(id, None)
        self._goals.pop(id, None)

    def end(self) -> None:
        """Abort the goals of the robot's nodes and remove the interface."""
        for task in (*self._tasks.values(), *self._cancels):
            task.cancel()
        super().end()
