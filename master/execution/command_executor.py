"""Command executor: robots' and users' commands change the graph, and are complete when their effects are."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from typing import TypeGuard
from weakref import WeakValueDictionary

from twisted.logger import Logger
from twisted.python.failure import Failure

from master.access import guests
from master.access.audit import Audit, Origin
from master.access.user_limits import UserLimits
from master.execution.effect_runner import EffectRunner, new_id, raise_first_error
from master.execution.lifecycle import Lifecycle
from master.graph.changes import undo
from master.graph.commands import CommandContext, execute
from master.graph.effects import Outcome
from master.graph.records import Process, Ref, Robot
from rce.control.calls.robots import Execute, Executed, PackedCommand
from rce.control.connection import Handlers
from rce.errors import ErrorInfo, InternalError, LimitExceeded, NotFound, RceError, TimedOut
from rce.process import metrics
from rce.protocol.messages import Command, DestroyContainer, UsedService

START_TIMEOUT = 60.0  # seconds until everything that a command asked for must be ready
COMMAND_TIMEOUT = 240.0  # seconds for a command as a whole: one that starts an environment may wait for both
MAX_COMMANDS = 5000  # of one user that are in progress
START_TOGETHER = 100  # commands of a frame that begin in one turn of the loop, and are stored in one transaction

log = Logger()
_commands = metrics.Timing("rce_command_seconds", "Time until a command was complete", "command")


class CommandExecutor:
    """Executes commands, within the rights of the sender and the limits of the owner."""

    def __init__(self, runner: EffectRunner, lifecycle: Lifecycle, limits: UserLimits, audit: Audit) -> None:
        self._runner = runner
        self._state = runner.state
        self._readiness = runner.readiness
        self._lifecycle = lifecycle
        self._limits = limits
        self._audit = audit
        self._in_progress: Counter[str] = Counter()  # commands by user
        self._orders: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # of robots whose commands begin

    def add_handlers(self, handlers: Handlers, process: Process) -> None:
        """Answer the commands that a Robot endpoint passes on."""
        handlers.on(Execute, lambda call: self._by_robot(process, call))

    async def _by_robot(self, process: Process, call: Execute) -> Executed:
        """Execute the commands of a frame, which begin in their order and after those of the robot's frames before."""
        user, _, tag = call.robot.partition("/")
        if len(call.commands) > MAX_COMMANDS:
            raise LimitExceeded(f"a frame has {len(call.commands)} commands, more than {MAX_COMMANDS}: divide it")
        self._robot_at(process, call.robot)
        tasks: list[asyncio.Task[UsedService | None]] = []
        order = self._orders.setdefault(call.robot, asyncio.Lock())
        async with order:
            for packed in call.commands:
                if tasks and len(tasks) % START_TOGETHER == 0:
                    await asyncio.sleep(0)  # the commands before this one begin
                tasks.append(asyncio.create_task(self._one_by_robot(process, user, tag, packed, call.again)))
        results = await asyncio.gather(*tasks, return_exceptions=True)
        failed = {position: info for position, error in enumerate(results) if (info := _info(error)) is not None}
        return Executed(failed, {position: each for position, each in enumerate(results) if _is_service(each)})

    async def _one_by_robot(
        self, process: Process, user: str, tag: str, packed: PackedCommand, repeated: bool
    ) -> UsedService | None:
        robot = self._robot_at(process, f"{user}/{tag}")
        command, origin = packed.unpack(), Origin("websocket", robot.address)
        about = guests.object_of(user, tag, command)
        with self._audit.auditing(guests.operation(tag, command), user, about, origin) as action:
            action.who, action.quiet = robot.by, guests.is_exempt_from_audit(tag, command)
            guests.check_command(robot.by, self._state, user, tag, command)
            return await self.execute(user, command, repeated, tag)

    def _robot_at(self, process: Process, name: str) -> Robot:
        """Return a robot with a session at this Robot endpoint.

        Raises:
            NotFound: It has none there.
        """
        robot = self._state.robots.get(name)
        if robot is None or robot.endpoint != process.name:
            raise NotFound(f"robot {name} has no session at {process.name}")
        return robot

    async def execute(self, user: str, command: Command, repeated: bool = False, robot: str = "") -> UsedService | None:
        """Execute a command of `user`; return when it is complete and stored, with the service of `UseService`.

        A command that does not become ready or cannot be stored is taken back, except a removal. `robot` is the robotID
        of the robot that gave it.

        Raises:
            RceError: The reason why it was refused or did not become ready.
        """
        if self._in_progress[user] >= MAX_COMMANDS:
            raise LimitExceeded(f"{MAX_COMMANDS} commands of {user} are in progress: wait until some complete")
        self._in_progress[user] += 1
        try:
            return await self._execute(user, command, repeated, robot)
        finally:
            self._in_progress[user] -= 1
            if not self._in_progress[user]:
                del self._in_progress[user]

    async def _execute(self, user: str, command: Command, repeated: bool, robot: str) -> UsedService | None:
        began = time.perf_counter()
        context = CommandContext(self._state, user, new_id, self._limits.of(user), repeated, robot, self._limits.of)
        outcome = execute(context, command)
        saved = self._runner.save(by_command=True)
        await self._complete(outcome)
        try:
            await saved
        except RceError:  # what is refused must not exist; it would be stored with the next change
            self._lifecycle.apply(undo(self._state, outcome))
            raise
        _commands.labels(type(command).__name__).observe_since(began)
        if isinstance(command, DestroyContainer):
            self._lifecycle.resettle()
        return outcome.service

    async def _complete(self, outcome: Outcome) -> None:
        waiting: dict[Ref, asyncio.Future[None]] = {
            awaited: self._readiness.when_ready(awaited) for awaited in (*outcome.awaits, *outcome.needs)
        }
        pending = [future for future in waiting.values() if not future.done()]  # the others were ready before
        try:
            running = self._runner.run(outcome.plan)
            if outcome.follows:
                self._lifecycle.apply(outcome.follows)
            async with asyncio.timeout(COMMAND_TIMEOUT):
                answers = await asyncio.shield(running)  # if it takes longer, its calls keep their order
                self._lifecycle.handle(answers)
                raise_first_error(answers)
                for awaited, future in waiting.items():
                    await self._readiness.wait(awaited, START_TIMEOUT, future)
        except (RceError, TimeoutError) as error:
            if pending and all(map(_is_resolved, pending)):
                return  # a later command removed it while this one was under way
            for future in waiting.values():
                future.cancel()
            self._lifecycle.apply(undo(self._state, outcome))
            if isinstance(error, TimeoutError):
                raise TimedOut(f"the command was not complete within {COMMAND_TIMEOUT:g} s") from None
            raise


def _is_resolved(future: asyncio.Future[None]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


def _is_service(result: object) -> TypeGuard[UsedService]:
    return isinstance(result, UsedService)


def _info(error: object) -> ErrorInfo | None:
    """Return what a robot is told about a command that ended with `error`; None if it was executed.

    Raises:
        BaseException: `error`, if it cancels the call.
    """
    if isinstance(error, RceError):
        return error.info
    if isinstance(error, Exception):
        log.failure("unhandled exception while executing a command of a robot", Failure(error))
        return InternalError("internal error while executing the command: see the Master's log").info
    if isinstance(error, BaseException):
        raise error
    return None
