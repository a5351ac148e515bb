"""Goals that a client sends, and actions whose goals it carries out."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from msgspec import UNSET

from endpoints.data.goals import MAX_GOALS
from endpoints.gateways.guest import Guest
from endpoints.gateways.rosbridge import encoding
from endpoints.gateways.rosbridge.encoding import Form
from endpoints.gateways.rosbridge.operations import (
    ActionFeedback,
    ActionResult,
    AdvertiseAction,
    CancelActionGoal,
    Id,
    SendActionGoal,
    UnadvertiseAction,
    key,
)
from endpoints.gateways.rosbridge.peer import Peer
from endpoints.gateways.uses import ACT, ASK, Arrived, Frame, Use
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError
from rce.protocol.names import parse_type

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # of action_msgs/GoalStatus
STATUSES = {"succeeded": SUCCEEDED, "canceled": CANCELED, "aborted": ABORTED}
NAMES = {status: name for name, status in STATUSES.items()}


@dataclass(eq=False)
class _Goal:
    action: str
    id: Id
    feedback: bool
    form: Form
    use: Use | None = None
    accepted: bool = False
    canceled: bool = False


class SentGoals:
    """Goals that a client has sent."""

    def __init__(self, guest: Guest, peer: Peer) -> None:
        self._guest = guest
        self._peer = peer
        self._uses: dict[tuple[str, str], Use] = {}  # by action and type
        self._goals: dict[str, _Goal] = {}  # by UUID

    def send(self, op: SendActionGoal) -> None:
        """Send a goal; its feedback, result or error is sent when it comes."""
        id = uuid.uuid4().hex
        form = Form("png" if op.compression == "png" else "none", op.fragment_size or 0)
        goal = _Goal(op.action, op.id, op.feedback, form)
        if len(self._goals) >= MAX_GOALS:
            self._answer(goal, LimitExceeded(f"{MAX_GOALS} goals are unfinished: wait for their ends"))
            return
        self._goals[id] = goal
        try:
            self._guest.run(self._send(id, goal, op), len(memoryview(op.args)))
        except LimitExceeded as error:
            self._fail(id, error)

    async def _send(self, id: str, goal: _Goal, op: SendActionGoal) -> None:
        try:
            await self._guest.changes.settle()
            type = op.action_type or await find_action_type(self._guest, op.action)
            goal.use = self._use_of(op.action, type)
            await asyncio.shield(goal.use.ready)
        except RceError as error:
            self._fail(id, error)
            return
        self._guest.data(goal.use, id, op.args, lambda error: self._fail(id, error), phase="goal", ifLost="cancel")

    def _use_of(self, action: str, type: str) -> Use:
        named = action, str(parse_type(type))
        if named in self._uses:
            return self._uses[named]
        use = self._uses[named] = self._guest.use(ASK, action, type, self._arrived, self._fail)
        use.on_end(lambda error: self._ended(named, use, error))
        return use

    def _ended(self, named: tuple[str, str], use: Use, error: RceError) -> None:
        if self._uses.get(named) is use:
            del self._uses[named]
        for id in [id for id, goal in self._goals.items() if goal.use is use]:
            self._fail(id, error)

    def _arrived(self, arrived: Arrived) -> Sequence[Frame]:
        message = arrived.message
        goal = self._goals.get(message.msgID)
        if goal is None:
            return ()
        if message.phase == "accepted":
            goal.accepted = True
            if goal.canceled:
                self._cancel(message.msgID, goal)
        elif message.phase == "rejected":
            self._fail(message.msgID, NotFound(f"action {goal.action} rejected the goal"))
        elif message.phase == "feedback" and goal.feedback:
            fields = _about(goal, "action_feedback")
            return encoding.with_value("values", arrived.value, goal.form, **fields)
        elif message.phase == "result":
            del self._goals[message.msgID]
            fields = _about(goal, "action_result") | {"status": STATUSES[message.status], "result": True}
            return encoding.with_value("values", arrived.value, goal.form, **fields)
        return ()

    def _fail(self, id: str, error: RceError) -> None:
        if error.info.fields.get("phase") == "cancel":  # the goal goes on
            self._peer.report(error)
            return
        goal = self._goals.pop(id, None)
        if goal is not None:
            self._answer(goal, error)

    def _answer(self, goal: _Goal, error: RceError) -> None:
        fields = _about(goal, "action_result") | {"status": ABORTED, "result": False}
        self._guest.send(*encoding.encoded(encoding.text(**fields, values=str(error)), goal.form))

    def cancel(self, op: CancelActionGoal) -> None:
        """Cancel a goal, now or as soon as it is accepted; raises NotFound."""
        for id, goal in self._goals.items():
            if goal.action == op.action and key(goal.id) == key(op.id):
                goal.canceled = True
                if goal.accepted:
                    self._cancel(id, goal)
                return
        raise NotFound(f"action {op.action[:200]} has no unfinished goal with this id")

    def _cancel(self, id: str, goal: _Goal) -> None:
        assert goal.use is not None
        self._guest.data(goal.use, id, encoding.EMPTY, self._peer.report, phase="cancel")


def _about(goal: _Goal, op: str) -> dict[str, object]:
    fields: dict[str, object] = {"op": op, "action": goal.action}
    return fields if goal.id is UNSET else fields | {"id": goal.id}


class ServedActions:
    """Actions whose goals a client carries out; it accepts every goal, and every request to cancel one."""

    def __init__(self, guest: Guest, peer: Peer) -> None:
        self._guest = guest
        self._peer = peer
        self._uses: dict[str, Use] = {}

    def advertise(self, op: AdvertiseAction) -> None:
        """Begin to carry out goals of an action; raises InvalidRequest or LimitExceeded."""
        parse_type(op.type)
        self._guest.check_room()  # before the earlier one is dropped
        self._drop(op.action)
        use = self._guest.use(
            ACT,
            op.action,
            op.type,
            lambda arrived: self._arrived(op, arrived),
            lambda _, error: self._peer.report(error),
        )
        self._uses[op.action] = use
        use.on_end(lambda error: self._ended(op, use, error))

    def _ended(self, op: AdvertiseAction, use: Use, error: RceError) -> None:
        if self._uses.get(op.action) is use:
            del self._uses[op.action]
        self._peer.report(error, op.id)

    def _arrived(self, op: AdvertiseAction, arrived: Arrived) -> Sequence[Frame]:
        message, use = arrived.message, self._uses.get(op.action)
        if use is None:
            return ()
        id = f"action_request:{op.action}:{message.msgID}"
        if message.phase == "goal":
            self._guest.data(use, message.msgID, encoding.EMPTY, self._peer.report, phase="accepted")
            fields = {"op": "send_action_goal", "id": id, "action": op.action, "action_type": op.type}
            return encoding.with_value("args", arrived.value, encoding.PLAIN, **fields, feedback=True)
        if message.phase == "cancel":
            self._guest.data(use, message.msgID, encoding.EMPTY, self._peer.report, phase="cancel")
            return (encoding.text(op="cancel_action_goal", id=id, action=op.action),)
        return ()

    def unadvertise(self, op: UnadvertiseAction) -> None:
        """Carry out goals of an action no more."""
        self._drop(op.action)

    def _drop(self, action: str) -> None:
        use = self._uses.pop(action, None)
        if use is not None:
            self._guest.drop(use)

    def feedback(self, op: ActionFeedback) -> None:
        """Send feedback about a goal; raises InvalidRequest."""
        use, id = self._goal(op.action, op.id)
        self._guest.data(use, id, op.values, self._peer.report, phase="feedback")

    def result(self, op: ActionResult) -> None:
        """End a goal; raises InvalidRequest."""
        use, id = self._goal(op.action, op.id)
        if not op.result and op.status not in (CANCELED, ABORTED):
            self._guest.data(use, id, encoding.EMPTY, self._peer.report, phase="result", status="aborted")
            return
        status = NAMES.get(op.status)
        if status is None:
            raise InvalidRequest(f"status {op.status} is not that of an end: send 4, 5 or 6")
        values = op.values if bytes(op.values).lstrip().startswith(b"{") else encoding.EMPTY
        self._guest.data(use, id, values, self._peer.report, phase="result", status=status)

    def _goal(self, action: str, id: Id) -> tuple[Use, str]:
        use = self._uses.get(action)
        if use is None:
            raise InvalidRequest(f"action {action[:200]} is not advertised by this client")
        return use, encoding.as_text(id).rpartition(":")[2]


async def find_action_type(guest: Guest, action: str) -> str:
    """Return the type of an action of the environment; raise NotFound if there is none."""
    for age in (1.0, 0.0):
        for each in (await guest.view.graph(age)).actions:
            if each.name == action:
                return each.types[0]
    raise NotFound(f"action {action[:200]} does not exist")
