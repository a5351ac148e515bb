"""Effect runner: stores what changed, runs plans, and sends status messages to robots."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, NamedTuple, TypeVar

from msgspec.structs import replace
from twisted.logger import Logger

from master.access.join_tokens import JoinTokens
from master.access.sealing import Seal
from master.execution.dispatcher import Dispatcher, Turn
from master.execution.readiness import Readiness
from master.graph import packages
from master.graph.effects import MarkReady, Plan, Send
from master.graph.records import Ref, Robot, user_of
from master.graph.state import State, followers
from master.storage.depot import Depot
from master.storage.store import Store
from rce.control.calls.call import Call, Nothing
from rce.control.calls.endpoints import PutSecrets, Secret
from rce.control.calls.environments import StartEnvironment
from rce.control.calls.robots import SendStatus
from rce.errors import ErrorInfo, NotFound, RceError, StartFailed, Unavailable
from rce.process.metrics import Family, gauge_family
from rce.protocol.messages import StatusData

log = Logger()
T = TypeVar("T")
Steps = list[MarkReady | Turn]


class Answer(NamedTuple):
    """Result of one call: what the process answered, or the error that it raised."""

    send: Send
    result: object


def new_id() -> str:
    """Return a random identifier of 32 hex digits."""
    return secrets.token_hex(16)


def raise_first_error(answers: Iterable[Answer]) -> None:
    """Raise the first error among the answers, if there is one."""
    for answer in answers:
        if isinstance(answer.result, RceError):
            raise answer.result


class EffectRunner:
    """Runs plans over the dispatcher. `depot` has the archives of packages that environments may need."""

    def __init__(
        self, state: State, store: Store, tokens: JoinTokens, depot: Depot | None, seal: Seal | None = None
    ) -> None:
        self.state = state
        self.seal = seal or Seal()
        self.dispatcher = Dispatcher()
        self.readiness = Readiness()
        self.status_observers: list[Callable[[str, StatusData], None]] = []  # called with a user and a status for them
        self._store = store
        self._tokens = tokens
        self._depot = depot
        self._plans: set[asyncio.Task[list[Answer]]] = set()
        self._tasks: set[asyncio.Task[Any]] = set()

    # --- plans --------------------------------------------------------------------------------------------------------

    def run(self, plan: Plan) -> asyncio.Task[list[Answer]]:
        """Begin to run a plan; the task returns the answers of all calls that were made.

        The turns of all calls are reserved at once, so plans keep the order in which they were made.
        """
        sequences: list[Steps] = [
            [self.dispatcher.reserve(step) if isinstance(step, Send) else step for step in steps] for steps in plan
        ]
        task = asyncio.create_task(self._run_plan(sequences))
        self._plans.add(task)
        task.add_done_callback(self._plan_ended)
        return task

    def _plan_ended(self, task: asyncio.Task[list[Answer]]) -> None:
        self._plans.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("defect while running a plan: {error!r}", error=error)

    async def _run_plan(self, sequences: list[Steps]) -> list[Answer]:
        if len(sequences) == 1:
            return await self._run_sequence(sequences[0])
        results = await asyncio.gather(*map(self._run_sequence, sequences), return_exceptions=True)
        answers: list[Answer] = []
        for result in results:
            if isinstance(result, BaseException):
                raise result
            answers += result
        return answers

    async def _run_sequence(self, steps: Steps) -> list[Answer]:
        """Take the steps in order; the first error ends them, except for a process that is away."""
        answers: list[Answer] = []
        complete = True
        try:
            for step in steps:
                if isinstance(step, MarkReady):
                    if complete:
                        self.readiness.mark_ready(step.ref)
                    continue
                try:
                    answers.append(Answer(step.send, await self._call(step)))
                except Unavailable as error:  # the others in the sequence get theirs in any case
                    log.info("{error}: it gets this by its next Sync", error=str(error))
                    complete = False
                except RceError as error:
                    answers.append(Answer(step.send, error))
                    break
        finally:
            for step in steps:
                if isinstance(step, Turn):
                    step.end()
        return answers

    async def _call(self, turn: Turn) -> object:
        try:
            control = await self.dispatcher.wait(turn)
            if turn.send.unless is not None and self.readiness.is_ready(turn.send.unless):
                return Nothing()
            call = await self._with_token(turn.send.call, turn.send.to)
            turn.going()  # those who wait for this run later
            return await control.call(call)
        finally:
            turn.end()

    def _with_values(self, call: PutSecrets, environment: str) -> PutSecrets:
        """Add the values of secrets; one that was removed meanwhile is left out, and its user is told."""
        user, found = user_of(environment), dict[str, Secret]()
        for name, secret in call.secrets.items():
            record = self.state.secrets.get(f"{user}/{name}")
            try:
                if record is None:
                    raise NotFound("it was removed")
                found[name] = replace(secret, value=self.seal.open(record.sealed))
            except NotFound as error:
                self.tell(user, error=NotFound(f"environment {environment} has no secret {name}: {error}").info)
        return PutSecrets(found)

    async def _with_token(self, call: Call[Any], to: str) -> Call[Any]:
        """Issue the join token of an environment's new life; earlier lives of it cannot join any more."""
        if isinstance(call, PutSecrets):
            return self._with_values(call, to)
        if not isinstance(call, StartEnvironment):
            return call
        token = secrets.token_hex(32)
        name = call.environment.name
        try:
            await self._tokens.renew(name, "environment", token)
        except RceError as error:  # Unavailable would mean that the machine is away
            raise StartFailed(f"environment {name} did not start: its join token cannot be stored: {error}") from None
        return StartEnvironment(replace(call.environment, token=token))

    # --- records ------------------------------------------------------------------------------------------------------

    def save(self, by_command: bool = False) -> asyncio.Future[None]:
        """Begin to store what changed; the future resolves when it is safe.

        Who waits for something that was removed is woken: without an error if a command removed it on purpose.
        """
        state = self.state
        if (
            state.packages.changed
            or state.offers.changed
            or any(key not in state.environments for key in state.environments.changed)
        ):
            self.remove_unused_archives()
        for table in state.tables():
            for gone in table.removed():
                if gone.kind == "environment":
                    self.keep(asyncio.create_task(self._revoke_tokens(gone.key)))
                if by_command:
                    self.readiness.release(gone)
                else:
                    self.readiness.fail(gone, NotFound(f"{gone} was removed before it came up"))
        saved = self._store.save(state)
        saved.add_done_callback(_log_error)
        return saved

    async def _revoke_tokens(self, environment: str) -> None:
        if environment not in self.state.environments:  # else it was made again, and its start revokes them
            await self._tokens.forget(environment)

    def remove_unused_archives(self) -> None:
        """Remove the archives that no package and no environment needs any more."""
        if self._depot is not None:
            named = packages.named(self.state)
            self._depot.sweep(named)
            self.keep(asyncio.create_task(self._depot.sweep_database(named)))

    # --- robots -------------------------------------------------------------------------------------------------------

    def tell(self, user: str, status: StatusData | None = None, error: ErrorInfo | None = None) -> None:
        """Send a status or an error to the robots of a user that asked for events."""
        self._observe(user, status)
        self._tell(self.state.robots.by(followers(user)), status, error)

    def tell_connected(self, interface: str, status: StatusData) -> None:
        """Send a status to the robots to which an interface is connected; to all of its user's if there is none."""
        ends = {end for each in self.state.connections.by(interface) for end in (each.sender, each.receiver)}
        owners = {found.owner for end in ends if (found := self.state.interfaces.get(end)) is not None}
        robots = [robot for owner in sorted(owners) if (robot := self.state.robots.get(owner)) is not None]
        if not robots:
            self._observe(user_of(interface), status)
        self._tell(robots or self.state.robots.by(user_of(interface)), status, None)

    def _observe(self, user: str, status: StatusData | None) -> None:
        if status is not None:
            for observer in self.status_observers:
                observer(user, status)

    def _tell(self, robots: Iterable[Robot], status: StatusData | None, error: ErrorInfo | None) -> None:
        """Make one call to each endpoint of the robots, which belong to one user."""
        names: dict[str, list[str]] = {}
        for robot in robots:
            if robot.endpoint in self.state.joined:
                names.setdefault(robot.endpoint, []).append(robot.name)
        for endpoint, of_endpoint in names.items():
            about = Ref("user", user_of(of_endpoint[0]))  # so that a user's statuses keep their order
            self.run([[Send(endpoint, SendStatus(of_endpoint, status, error), about)]])

    # --- background tasks ---------------------------------------------------------------------------------------------

    def later(self, seconds: float, work: Callable[[], Coroutine[None, None, None]]) -> asyncio.Task[None]:
        """Run a coroutine after a pause."""

        async def wait() -> None:
            await asyncio.sleep(seconds)
            await work()

        return self.keep(asyncio.create_task(wait()))

    def keep(self, task: asyncio.Task[T]) -> asyncio.Task[T]:
        """Hold a task until it ends, and log its error."""
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(_log_error)
        return task

    def families(self) -> list[Family]:
        """Return the metrics of plans and waiters."""
        return [
            gauge_family("rce_plans", "Commands whose effects are under way at processes", [], {(): len(self._plans)}),
            gauge_family(
                "rce_waiting", "Commands that wait for something to become ready", [], {(): self.readiness.waiters()}
            ),
        ]

    async def close(self) -> None:
        """Cancel all tasks, and store what changed."""
        for task in [*self._tasks, *self._plans]:
            task.cancel()
        await asyncio.gather(*self._tasks, *self._plans, return_exceptions=True)
        await self.save()


def _log_error(task: asyncio.Future[Any]) -> None:
    if task.cancelled() or (error := task.exception()) is None:
        return
    if isinstance(error, RceError):
        log.warn("{error}", error=str(error))
    else:
        log.error("defect: {error!r}", error=error)
