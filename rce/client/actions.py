"""Action clients and action servers of a robot, made by the methods of `Robot` and `Environment`."""

from __future__ import annotations

import asyncio
import inspect
import logging
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, NamedTuple

from rce.client.connection import Message
from rce.client.interface import CONNECT_TIMEOUT, Interface, Owner
from rce.client.stream import Stream
from rce.client.values import decode_message, encode
from rce.errors import Forbidden, NotFound, RceError, TimedOut, Unavailable
from rce.protocol.blobs import detach
from rce.protocol.messages import GoalStatus, Phase

FEEDBACK_DEPTH = 100  # unread feedback of a goal that is kept

log = logging.getLogger("rce.client")


class GoalResult(NamedTuple):
    """End of a goal: its status, `succeeded`, `canceled` or `aborted`, and the value of its result."""

    status: GoalStatus
    value: Any


class _ActionInterface(Interface):
    def _send(self, id: str, phase: Phase, **more: Any) -> None:
        """Send a message about a goal, with `msg` as its value; nothing while the robot is offline."""
        if self._owner.connection is not None:
            data = {"iTag": self.tag, "type": self.type_name, "msgID": id, "phase": phase}
            wire, blobs = detach(more)
            self._owner.connection.put_message(self.tag, encode({"type": "DM", "data": data | wire}), blobs)


class Goal:
    """A goal that was accepted; made by `ActionClient.send_goal`.

    Iterate over it with `async for` to get its feedback; the iteration ends with the goal. It may be read later: the
    newest 100 unread values are kept.

    Attributes:
        id: UUID of the goal, 32 hex digits.
        feedback: Queue of the unread feedback.
    """

    def __init__(self, client: ActionClient, id: str) -> None:
        loop = asyncio.get_running_loop()
        self.id = id
        self.feedback: Stream[Any] = Stream(FEEDBACK_DEPTH)
        self._client = client
        self._accepted: asyncio.Future[bool] = loop.create_future()
        self._canceling: asyncio.Future[None] | None = None
        self._result: asyncio.Future[GoalResult] = loop.create_future()

    def __aiter__(self) -> AsyncIterator[Any]:
        return aiter(self.feedback)

    async def result(self, timeout: float | None = None) -> GoalResult:  # noqa: ASYNC109  # as in `Stream.get`
        """Return the result, waiting until the goal ends, also while the robot is offline.

        Args:
            timeout: Seconds to wait; None to wait without limit.

        Raises:
            TimedOut: The goal did not end within `timeout` seconds.
            Lost: The action server is gone.
            NotConnected: The connection to the action server was removed.
            Unavailable: The action client or the robot was closed.
            RceError: The error with which the goal failed.
        """
        try:
            async with asyncio.timeout(timeout):
                return await asyncio.shield(self._result)
        except TimeoutError:
            raise TimedOut(f"the goal of {self._client.tag} did not end within {timeout:g} s") from None

    async def cancel(self, timeout: float = CONNECT_TIMEOUT) -> None:  # noqa: ASYNC109  # the error names it
        """Ask the action server to cancel the goal. `result` tells how it ended.

        Args:
            timeout: Seconds to wait for a connection, and again for the answer.

        Raises:
            Forbidden: The server does not cancel this goal.
            NotFound: The goal has ended.
            TimedOut: The server did not answer within `timeout` seconds.
            NotConnected: The action client had no peer for `timeout` seconds.
            Unavailable: The socket broke before the answer came.
        """
        if self._result.done():
            raise NotFound(f"the goal of {self._client.tag} has ended: it cannot be canceled")
        await self._client.wait_connected(timeout)
        if self._canceling is None or self._canceling.done():
            self._canceling = asyncio.get_running_loop().create_future()
            self._client._send(self.id, "cancel")
        try:
            async with asyncio.timeout(timeout):
                await asyncio.shield(self._canceling)
        except TimeoutError:
            raise TimedOut(f"action {self._client.tag} did not answer within {timeout:g} s") from None

    # Called by the ActionClient only.

    def _set(self, phase: Phase, status: GoalStatus, value: Any) -> None:
        match phase:
            case "accepted" | "rejected":
                _settle(self._accepted, phase == "accepted")
            case "feedback":
                self.feedback.put(value)
            case "cancel":
                _settle(self._canceling, None)
            case "result":
                _settle(self._accepted, True)
                if status == "canceled":  # its end may overtake the answer to the request
                    _settle(self._canceling, None)
                _settle(self._result, GoalResult(status, value))
                self._finish()

    def _fail(self, error: RceError) -> None:
        for future in (self._accepted, self._result):
            if not future.done():
                future.set_exception(error)
                future.exception()  # it need not be read: the other one has it too
        self._finish()

    def _finish(self) -> None:
        self._cancel_failed(Unavailable("the goal has ended"))
        self.feedback.end()

    def _cancel_failed(self, error: RceError) -> None:
        if self._canceling is not None and not self._canceling.done():
            self._canceling.set_exception(error)
            self._canceling.exception()


def _settle(future: asyncio.Future[Any] | None, value: Any) -> None:
    if future is not None and not future.done():
        future.set_result(value)


class ActionClient(_ActionInterface):
    """Interface through which the robot sends goals to an action server.

    Several goals may be under way at the same time. Their results are not lost with a socket: when the robot is back,
    it asks for them again.

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS action type.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str) -> None:
        super().__init__(owner, tag, type_name)
        self._goals: dict[str, Goal] = {}
        self._stale = False  # the socket broke, and messages of the goals may have been lost with it

    async def send_goal(
        self,
        goal: Any,
        *,
        timeout: float = CONNECT_TIMEOUT,  # noqa: ASYNC109  # the error names it
        cancel_if_lost: bool = False,
    ) -> Goal:
        """Send a goal, and wait until the server has accepted it.

        Args:
            goal: The goal as a dict, or bytes (CDR) with a raw interface.
            timeout: Seconds to wait for the action to be connected, and again for the server's decision. A goal that is
                not decided upon in time is canceled.
            cancel_if_lost: Cancel the goal when the robot's session ends, because it closed or stayed away for longer
                than the grace period. Without it the goal goes on.

        Raises:
            Forbidden: The server rejected the goal.
            NotFound: The environment has no such action server.
            NotConnected: The interface had no peer for `timeout` seconds.
            TimedOut: The server did not decide within `timeout` seconds.
            InvalidRequest: The goal cannot be expressed in JSON or does not fit the type.
            RceError: Any other error with which the goal failed.
        """
        await self.wait_connected(timeout)
        sent = Goal(self, uuid.uuid4().hex)
        self._goals[sent.id] = sent
        try:
            self._send(sent.id, "goal", msg=goal, **({"ifLost": "cancel"} if cancel_if_lost else {}))
            async with asyncio.timeout(timeout):
                accepted = await asyncio.shield(sent._accepted)
        except TimeoutError:
            self._give_up(sent)
            raise TimedOut(f"action {self.tag} ({self.type_name}) did not answer within {timeout:g} s") from None
        except BaseException:
            self._give_up(sent)
            raise
        if not accepted:
            del self._goals[sent.id]
            raise Forbidden(f"action {self.tag} ({self.type_name}) rejected the goal")
        return sent

    def _give_up(self, goal: Goal) -> None:
        if self._goals.pop(goal.id, None) is not None and not goal._accepted.done():
            self._send(goal.id, "cancel")

    def _receive(self, message: Message) -> None:
        data = message.data
        goal = self._goals.get(data.msgID)
        if goal is None:
            return  # it was given up
        goal._set(data.phase, data.status, decode_message(data, message.blobs))
        if data.phase == "result":
            del self._goals[data.msgID]

    def _fail_call(self, error: RceError, msg_id: str) -> bool:
        goal = self._goals.get(msg_id)
        if goal is not None and error.info.fields.get("phase") == "cancel":
            goal._cancel_failed(error)
        elif goal is not None:
            del self._goals[msg_id]
            goal._fail(error)
        return goal is not None

    def _set_status(self, connected: bool) -> None:
        super()._set_status(connected)
        if self._stale and self.connected:
            self._stale = False
            for goal in self._goals.values():
                self._send(goal.id, "result")

    def _disconnected(self) -> None:
        super()._disconnected()
        self._stale = True
        for goal in self._goals.values():
            goal._cancel_failed(Unavailable("the socket broke: it is not known whether the goal is being canceled"))

    def _end(self, error: RceError | None) -> None:
        super()._end(error)
        for goal in self._goals.values():
            goal._fail(error or Unavailable("the robot has been closed"))
        self._goals.clear()


class ServerGoal:
    """A goal that this robot carries out; passed to the handler of an `ActionServer`.

    Attributes:
        id: UUID of the goal, 32 hex digits.
        request: The goal's value.
        canceled: True once its cancellation was asked for.
    """

    def __init__(self, server: ActionServer, id: str, request: Any) -> None:
        self.id = id
        self.request = request
        self.canceled = False
        self._server = server
        self._interruptible = False  # it is being decided upon, or its handler runs

    def publish_feedback(self, value: Any) -> bool:
        """Send feedback; returns False if it was dropped because the robot is offline or sends too slowly.

        Raises:
            InvalidRequest: It cannot be expressed in JSON.
        """
        connection = self._server._connection()
        if connection is None or connection.room(self._server.tag) is not None:
            return False
        self._server._send(self.id, "feedback", msg=value)
        return True


Handler = Callable[[ServerGoal], Awaitable[Any] | Any]
Accept = Callable[[Any], bool | Awaitable[bool]]


class ActionServer(_ActionInterface):
    """Interface through which the robot carries out goals.

    Each goal runs the handler. What it returns is the result. When the goal is to be canceled, the handler gets an
    `asyncio.CancelledError`, as a task that is cancelled: what it returns then is the result of a canceled goal. If it
    raises another exception, the goal is aborted, and the asker gets the message. It may also return a `GoalResult`,
    which says how the goal ended. Goals go on while the robot is offline, and their results are sent when it is back.

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS action type.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, handler: Handler, accept: Accept | None = None) -> None:
        super().__init__(owner, tag, type_name)
        self._handler = handler
        self._accept = accept
        self._running: dict[str, tuple[ServerGoal, asyncio.Task[None]]] = {}

    def _receive(self, message: Message) -> None:
        id = message.data.msgID
        if message.data.phase == "cancel":
            self._cancel(id)
        elif message.data.phase == "goal":
            goal = ServerGoal(self, id, decode_message(message.data, message.blobs))
            decision = self._decide(goal.request)
            if isinstance(decision, bool):
                self._send(id, "accepted" if decision else "rejected")
                if not decision:
                    return
                work = self._run(goal)
            else:
                goal._interruptible = True
                work = self._run_if(goal, decision)
            task = asyncio.create_task(work, name=f"rce goal of {self.tag}")
            self._running[id] = goal, task
            task.add_done_callback(lambda _: self._running.pop(id, None))

    def _decide(self, request: Any) -> bool | Awaitable[bool]:
        try:
            return self._accept is None or self._accept(request)
        except Exception:
            log.exception("the function that accepts goals of %s failed", self.tag)
            return False

    async def _run_if(self, goal: ServerGoal, decision: Awaitable[bool]) -> None:
        try:
            accepted = await decision
        except asyncio.CancelledError:
            if not goal.canceled:
                raise  # the robot is being closed
            accepted = False
        except RceError as error:
            log.warning("a goal of %s is rejected: %s", self.tag, error)
            accepted = False
        except Exception:
            log.exception("the function that accepts goals of %s failed", self.tag)
            accepted = False
        goal._interruptible = False
        self._send(goal.id, "accepted" if accepted else "rejected")
        if accepted:
            await self._run(goal)

    def _cancel(self, id: str) -> None:
        goal, task = self._running.get(id, (None, None))
        if goal is None or task is None:
            self._send(id, "cancel", error="the goal has ended")
            return
        self._send(id, "cancel")
        goal.canceled = True
        if (
            goal._interruptible
        ):  # a task that has not begun would end without a word, and one that ends must not lose it
            task.cancel()

    async def _run(self, goal: ServerGoal) -> None:
        end: dict[str, Any]
        try:
            if goal.canceled:
                raise asyncio.CancelledError
            goal._interruptible = True
            result = self._handler(goal)
            value = await result if inspect.isawaitable(result) else result
            if not isinstance(value, GoalResult):
                value = GoalResult("canceled" if goal.canceled else "succeeded", value)
            end = {"status": value.status, "msg": value.value}
        except asyncio.CancelledError:
            if not goal.canceled:
                raise  # the robot is being closed
            end = {"status": "canceled"}
        except RceError as error:
            end = {"status": "aborted", "error": str(error)}
        except Exception as error:
            log.exception("the handler of action %s failed", self.tag)
            end = {"status": "aborted", "error": f"{type(error).__name__}: {error}"}
        finally:
            goal._interruptible = False
        await self._finish(goal, end)

    async def _finish(self, goal: ServerGoal, end: dict[str, Any]) -> None:
        while self._connection() is None and self._ended is None:
            await self._open.wait()
        try:
            self._send(goal.id, "result", **end)
        except RceError as error:
            self._send(goal.id, "result", status="aborted", error=str(error))

    def _end(self, error: RceError | None) -> None:
        super()._end(error)
        for _, task in self._running.values():
            task.cancel()
