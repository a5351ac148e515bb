"""The Master at work: processes join it, robots' commands reach the graph, effects reach the processes."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable
from typing import TypeVar

from msgspec.structs import replace
from twisted.logger import Logger

import rce
from master import graph, inventory, packages
from master.answers import Answers
from master.attendance import Attendance
from master.audit import Audit
from master.carrier import Carrier
from master.depot import FETCH_PATH, Depot
from master.effects import Send
from master.events import Events
from master.feed import Feed
from master.gauges import Gauges
from master.guard import Guard
from master.lending import Lending
from master.lifecycle import Lifecycle
from master.limits import Limits
from master.links import Links
from master.policies import UNLIMITED, Policy
from master.processes import Processes
from master.records import Environment, Process, State, at, user_of, what
from master.rim import Rim, ids
from master.sessions import Sessions
from master.shown import Shown
from master.sight import Sight
from master.store import Store
from master.tracing import Tracer
from master.users import Users
from rce import metrics
from rce.calls.call import Call, Nothing
from rce.calls.endpoints import Report
from rce.calls.environments import FetchPackage, StartEnvironment, Ticket
from rce.calls.joining import Hello, Welcome
from rce.calls.robots import Definitions, Describe
from rce.calls.watching import ReadMetrics
from rce.control import Control, Handlers
from rce.errors import InvalidRequest, NotFound, RceError, Unauthorized, Unavailable, UnknownType
from rce.messages import Command, DestroyContainer

START_TIMEOUT = 60.0  # seconds until what was asked for is real
ASK_TIMEOUT = 5.0

log = Logger()
_commands = metrics.Timing("rce_command_seconds", "Time until a command was complete", "command")
R = TypeVar("R")


class Master:
    """`grace` is how long a robot that lost its socket keeps its session, `machine_grace` how long a machine may be
    away before its environments are lost, in seconds; `policy` is that of users who have none of their own. Archives of
    the `depot` are fetched at the HTTP entry, whose scheme and port `entry` has.
    """

    def __init__(
        self,
        store: Store,
        grace: float,
        policy: Policy = UNLIMITED,
        machine_grace: float = 30.0,
        depot: Depot | None = None,
    ) -> None:
        self.state = State()
        self.users = Users(store)
        self.audit = Audit(store)
        self.limits = Limits(store, policy)
        self.processes = Processes(store)
        self.entry = ("http", 0)
        self._depot = depot
        self._store = store
        self._carrier = Carrier(self._prepare, lambda send, result: self._answers.take(send, result))
        self._rim = Rim(self.state, store, self._carrier, self._sweep)
        self._lives = Lifecycle(self._rim)
        self._answers = Answers(self._rim, self._lives)
        self._links = Links(self._rim)
        self._lending = Lending(self.users, self.audit)
        self.shown = Shown(self.state, self._carrier.is_real)
        self.guard = Guard(self.users, self.state, self._rim.apply)
        self.gauges = Gauges(self.state, self._carrier, self.shown)
        self.tracer = Tracer(self.state, self._carrier)
        self.feed = Feed(Sight(self.shown, self._carrier), self.gauges.watch)
        self.events = Events(self.state)
        self._rim.listeners.append(self.events.told)
        self.sessions = Sessions(self._rim, self.users, self.audit, self.limits, self.feed.sight, self.execute)
        self.attendance = Attendance(self._rim, self._lives, self.events, self.feed.sight, grace, machine_grace)

    async def start(self) -> None:
        """Take up where an earlier Master ended: processes join again, and who does not is gone after a while."""
        await self._store.load(self.state)
        await self.limits.open()
        self._rim.keep(asyncio.create_task(self.limits.follow()))
        self._rim.keep(asyncio.create_task(self.guard.follow()))
        packages.drop_strays(self.state, set(await self.users.names()))
        self._sweep()
        self.attendance.begin()

    async def stop(self) -> None:
        self.gauges.close()
        await self._rim.close()

    # --- processes ----------------------------------------------------------------------------------------------------

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        """Let a process in; see `rce.control.Joiner`."""
        if hello.version != rce.__version__:
            raise InvalidRequest(f"{hello.role} {hello.name} is version {hello.version}, the Master {rce.__version__}")
        credential = await self.processes.admit(hello.name, hello.role, hello.token)
        environment = self.state.environments.get(hello.name)
        if hello.role == "environment" and environment is None:
            raise Unauthorized(f"environment {hello.name} is not wanted any more")
        process = Process(
            hello.name,
            hello.role,  # type: ignore[arg-type]  # admitted: so it is one of the roles
            environment.run if environment else hello.incarnation,
            hello.host,
            hello.addresses,
            hello.url,
            hello.capacity,
            hello.features,
            hello.gpus,
        )
        handlers = self._handlers(process)
        return Welcome(credential), handlers, lambda control: self.attendance.joined(process, hello, control)

    def _handlers(self, process: Process) -> Handlers:
        handlers = Handlers()
        if process.role == "robot":
            self.sessions.add_to(handlers, process)
            handlers.on(Describe, self._describe)
        elif process.role == "service":
            self._lending.add_to(handlers, process)
        elif process.role == "environment":
            self._lives.of_environment(handlers, process)
            handlers.on(Report, lambda call: self._report(process, call))
        else:
            self._lives.of_machine(handlers)
            handlers.on(FetchPackage, lambda call: self._fetch_package(process, call))
        self._links.add_to(handlers, process)
        return handlers

    # --- what is asked of it ------------------------------------------------------------------------------------------

    async def execute(self, user: str, command: Command, again: bool = False, guest: str = "") -> Nothing:
        """Carry a user's command out to its completion; what did not become real is taken back."""
        began = time.perf_counter()
        outcome = graph.execute(self.state, user, command, ids, again, self.limits.of(user), guest)
        saved = self._rim.save(by_command=True)
        expected = {key: self._carrier.expect(key) for key in outcome.awaits}
        try:
            await self._carrier.carry(outcome.plan)
            for key, future in expected.items():
                await self._carrier.wait(key, START_TIMEOUT, future)
        except RceError:
            if expected and all(future.done() and not future.exception() for future in expected.values()):
                return Nothing()  # a later command took it back while this one was on its way
            for future in expected.values():
                future.cancel()
            self._rim.apply(graph.undo(self.state, outcome))
            raise
        await saved
        _commands.of(type(command).__name__).since(began)
        if isinstance(command, DestroyContainer):
            await self._rim.resettle()
        return Nothing()

    async def _describe(self, call: Describe) -> Definitions:
        """Ask the user's environments, those that are starting once they are there."""
        for environment in self.state.environments.by(call.user):
            try:
                return await self.ask(environment, call)
            except RceError as error:
                log.debug("{name} does not know {type}: {error}", name=environment.name, type=call.type, error=error)
        raise UnknownType(f"type {call.type} is known neither here nor in an environment of {call.user}")

    async def ask(self, environment: Environment, call: Call[R]) -> R:
        """Ask an environment, once it is there. TimedOut, Unavailable, and what the environment answers."""
        await self._carrier.wait(what(environment), START_TIMEOUT)
        control = self._carrier.controls.get(environment.name)
        if control is None:
            raise Unavailable(f"environment {environment.name} is away at present")
        return await control.call(call)

    def own_metrics(self) -> list[metrics.Family]:
        """What the Master counts of itself."""
        return metrics.families("master", lambda: inventory.families(self.shown), self._carrier.families)

    async def metrics_of(self, process: str) -> list[metrics.Family]:
        """What a process counts of itself. Unavailable, TimedOut."""
        return (await self._carrier.ask(process, ReadMetrics(), ASK_TIMEOUT)).families

    async def missing(self) -> list[str]:
        """What the platform lacks to do what it is for, in sentences."""
        return [*inventory.lacking(self.state), *await self._store.missing()]

    async def _report(self, process: Process, call: Report) -> Nothing:
        self._rim.tell(user_of(process.name), error=call.error)  # an environment speaks to its own user only
        return Nothing()

    async def _fetch_package(self, process: Process, call: FetchPackage) -> Ticket:
        """A task set gets what its own environments are to see."""
        needed = any(
            call.digest in environment.packages for environment in self.state.environments.by(at(process.name))
        )
        if self._depot is None or not needed:
            raise NotFound(f"no environment of {process.name} has the package {call.digest[:80]}")
        token, size = self._depot.ticket(call.digest)
        scheme, port = self.entry
        return Ticket(scheme, port, FETCH_PATH, token, size)

    # --- on the way out -----------------------------------------------------------------------------------------------

    async def _prepare(self, send: Send) -> Send:
        """A new life of an environment gets a new join token, and its earlier ones can join no more."""
        call = send.call
        if not isinstance(call, StartEnvironment):
            return send
        token = secrets.token_hex(32)
        await self.processes.forget(call.environment.name)
        await self.processes.allow(call.environment.name, "environment", token)
        return replace(send, call=StartEnvironment(replace(call.environment, token=token)))

    def _sweep(self) -> None:
        if self._depot is not None:
            self._depot.sweep(packages.named(self.state))

    async def save(self) -> None:
        """Returns once all changes are safe. What users asked for by other ways than commands is saved by this."""
        await self._rim.save()
