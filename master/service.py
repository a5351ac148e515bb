"""The Master: the parts of it put together, and the processes that join it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TypeVar

from twisted.logger import Logger

import rce
from master import shipped_services
from master.access.audit import Audit
from master.access.guard import Guard
from master.access.join_tokens import JoinTokens
from master.access.knowledge_calls import KnowledgeCalls
from master.access.robot_questions import RobotQuestions
from master.access.sealing import Seal
from master.access.service_calls import ServiceCalls
from master.access.user_limits import UserLimits
from master.access.users import Users
from master.execution.command_executor import START_TIMEOUT, CommandExecutor
from master.execution.effect_runner import EffectRunner
from master.execution.instance_keeper import InstanceKeeper
from master.execution.lifecycle import Lifecycle
from master.execution.links import Links
from master.execution.process_tracker import ProcessTracker
from master.execution.removals import Removals
from master.execution.robot_sessions import RobotSessions
from master.graph import catalogue, packages, reconcile, secrets
from master.graph.effects import Plan
from master.graph.limits import UNLIMITED, Policy
from master.graph.records import Environment, Process, ref, user_of
from master.graph.state import State, at
from master.live import inventory
from master.live.events import Events
from master.live.feed import Feed
from master.live.gauges import Gauges
from master.live.presenter import Presenter
from master.live.tracing import Tracer
from master.live.view_cache import ViewCache
from master.storage.depot import FETCH_PATH, Depot
from master.storage.store import Store
from rce.control.calls.call import Call, Nothing
from rce.control.calls.endpoints import Report
from rce.control.calls.environments import DownloadTicket, FetchPackage, ReportRelays
from rce.control.calls.joining import Hello, InviteSibling, Welcome
from rce.control.calls.knowledge import SERVICE, AskKnowledge, ReportChanges
from rce.control.calls.recordings import BeginRecording, RecordingQuota
from rce.control.calls.watching import ReadMetrics
from rce.control.connection import Control, Handlers
from rce.errors import InvalidRequest, NotFound, Unauthorized, Unavailable, clipped
from rce.net.tls import Tls
from rce.process import metrics
from rce.protocol.messages import DropEvent

ASK_TIMEOUT = 5.0  # seconds

log = Logger()
R = TypeVar("R")


class Master:
    """The Master, without its ports.

    `grace` is the grace period of robots that lost their socket, `machine_grace` that of machines before their
    environments are lost, in seconds. `policy` is that of users who have none of their own. Archives of the `depot` are
    fetched at the HTTP entry, whose scheme and port are in `entry`. `tls` are the certificates of the control port.
    `seal` keeps users' secrets.
    """

    def __init__(
        self,
        store: Store,
        grace: float,
        policy: Policy = UNLIMITED,
        machine_grace: float = 30.0,
        depot: Depot | None = None,
        tls: Tls | None = None,
        seal: Seal | None = None,
    ) -> None:
        self.state = State()
        self.users = Users(store)
        self.audit = Audit(store)
        self.limits = UserLimits(store, policy)
        self.join_tokens = JoinTokens(store)
        self.entry = ("http", 0)
        self.seal = seal or Seal()
        self._depot = depot
        self._store = store
        self._runner = EffectRunner(self.state, store, self.join_tokens, depot, self.seal)
        self._lifecycle = Lifecycle(self._runner)
        self._links = Links(self._runner, self._lifecycle)
        self._service_calls = ServiceCalls(self.users, self.audit)
        self.robot_questions = RobotQuestions(self.state, self.ask)
        dispatcher, readiness = self._runner.dispatcher, self._runner.readiness
        self._knowledge_calls = KnowledgeCalls(self.users, self.audit, dispatcher)
        self.presenter = Presenter(self.state, readiness)
        self.guard = Guard(self.users, self.state, self._lifecycle.apply)
        self.gauges = Gauges(self.state, dispatcher, self.presenter)
        self.tracer = Tracer(self.state, dispatcher)
        self.feed = Feed(ViewCache(self.presenter, readiness), self.gauges.watch)
        self.events = Events(self.state)
        self._runner.status_observers.append(self.events.status_sent)
        self.commands = CommandExecutor(self._runner, self._lifecycle, self.limits, self.audit)
        self.sessions = RobotSessions(
            self._runner, self._lifecycle, self.users, self.audit, self.limits, self.feed.view_cache
        )
        self.process_tracker = ProcessTracker(
            self._runner, self._lifecycle, self.events, self.feed.view_cache, grace, machine_grace
        )
        self.instance_keeper = InstanceKeeper(self._runner, self._lifecycle, self.limits.of)
        self.removals = Removals(self.state, self.join_tokens, self.process_tracker, self._lifecycle, tls)

    async def start(self) -> None:
        """Load what an earlier Master stored, and wait for its processes to join again."""
        await self._store.load(self.state)
        await self.removals.read()
        await self.guard.read_removals()
        await self.join_tokens.keep_environments({environment.name for environment in self.state.environments})
        await self.limits.open()
        self._runner.keep(asyncio.create_task(self.limits.follow()))
        self._runner.keep(asyncio.create_task(self.guard.follow()))
        self._runner.keep(asyncio.create_task(self.removals.follow()))
        self._runner.keep(asyncio.create_task(self.instance_keeper.follow()))
        users = set(await self.users.names())
        packages.drop_strays(self.state, users)
        catalogue.drop_strays(self.state, users)
        secrets.drop_strays(self.state, users)
        if self._depot is not None:
            await self._depot.adopt(packages.named(self.state))
        shipped_services.add_to(self.state)
        self._runner.remove_unused_archives()
        self.process_tracker.begin()

    async def stop(self) -> None:
        """Cancel what runs, and store what changed."""
        self.gauges.close()
        await self._runner.close()
        await self.audit.flush()

    async def save(self) -> None:
        """Return when all changes are stored."""
        await self._runner.save()

    async def apply(self, plan: Plan) -> None:
        """Run a plan in the background; return when what changed is stored."""
        self._lifecycle.apply(plan)
        await self.save()

    # --- processes ----------------------------------------------------------------------------------------------------

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        """Let a process join; see `rce.control.server.Joiner`.

        Raises:
            InvalidRequest: It has another version than the Master.
            Unauthorized: Its token or credential is not valid, or its environment was removed.
            Unavailable: Its task set has not told yet how the host of this environment is reached; it tries again.
        """
        if hello.version != rce.__version__:
            raise InvalidRequest(f"{hello.role} {hello.name} is version {hello.version}, the Master {rce.__version__}")
        credential = await self.join_tokens.admit(hello.name, hello.role, hello.token, hello.credential)
        environment = self.state.environments.get(hello.name)
        if hello.role == "environment" and environment is None:
            await self.join_tokens.forget(hello.name)
            raise Unauthorized(f"environment {hello.name} was removed")
        process = reconcile.process_of(self.state, hello)
        handlers = self._handlers(process)
        return Welcome(credential), handlers, lambda control: self.process_tracker.joined(process, hello, control)

    def _handlers(self, process: Process) -> Handlers:
        handlers = Handlers()
        match process.role:
            case "robot":
                self.sessions.add_handlers(handlers, process)
                self.commands.add_handlers(handlers, process)
                handlers.on(InviteSibling, lambda call: self.join_tokens.invite_sibling(process.name, call.number))
                self.robot_questions.add_handlers(handlers, process)
            case "service":
                self._service_calls.add_handlers(handlers, process)
                if process.name == SERVICE:
                    handlers.do(ReportChanges, lambda call: self.events.knowledge_changed(call.changes))
            case "environment":
                self._lifecycle.add_environment_handlers(handlers, process)
                handlers.on(Report, lambda call: self._report(process, call))
                handlers.on(AskKnowledge, lambda call: self._knowledge_calls.answer(process, call))
            case "container":
                self._lifecycle.add_machine_handlers(handlers)
                handlers.do(ReportRelays, lambda call: self._relays_changed(process, call))
                handlers.on(FetchPackage, lambda call: self._fetch_package(process, call))
                handlers.on(BeginRecording, lambda call: self._begin_recording(process, call))
        self._links.add_handlers(handlers, process)
        return handlers

    # --- calls of processes -------------------------------------------------------------------------------------------

    async def _report(self, process: Process, call: Report) -> Nothing:
        if call.error is not None:  # an environment reaches its own user only
            self._runner.tell(user_of(process.name), error=clipped(call.error))
        if call.drops:
            tag = process.name.partition("/")[2]
            self._runner.tell_connected(
                f"{process.name}/{call.interface}",
                DropEvent(f"{tag}/{call.interface}", call.drops, f"in environment {tag}"),
            )
        return Nothing()

    def _relays_changed(self, process: Process, call: ReportRelays) -> None:
        if process.name in self.state.processes:
            self._lifecycle.apply(reconcile.relays_changed(self.state, process.name, call.relays))

    async def _fetch_package(self, process: Process, call: FetchPackage) -> DownloadTicket:
        """Give a task set a ticket for a package that one of its environments needs."""
        needed = any(
            call.digest in environment.packages for environment in self.state.environments.by(at(process.name))
        )
        if self._depot is None or not needed:
            raise NotFound(f"no environment of {process.name} has the package {call.digest[:80]}")
        await self._depot.provide(call.digest)
        token, size = self._depot.ticket(call.digest)
        scheme, port = self.entry
        return DownloadTicket(scheme, port, FETCH_PATH, token, size)

    async def _begin_recording(self, process: Process, call: BeginRecording) -> RecordingQuota:
        """Tell a task set the quota of a recorder's user, if one of its environments has that recorder."""
        environment = self.state.environments.get(call.environment)
        known = f"{call.environment}/{call.recorder}" in self.state.recorders
        if environment is None or environment.machine != process.name or not known:
            raise NotFound(f"{call.environment[:300]} has no recorder {call.recorder[:80]!r} on {process.name}")
        return self.recording_quota(user_of(environment.name))

    # --- questions to processes ---------------------------------------------------------------------------------------

    async def ask(self, environment: Environment, call: Call[R], seconds: float = ASK_TIMEOUT) -> R:
        """Make a call at an environment, once it is ready.

        Raises:
            TimedOut: It did not become ready, or did not answer within `seconds` then.
            Unavailable: It is away.
            RceError: It refused the call.
        """
        await self._runner.readiness.wait(ref(environment), START_TIMEOUT)
        control = self._runner.dispatcher.controls.get(environment.name)
        if control is None:
            raise Unavailable(f"environment {environment.name} is away at present")
        return await control.call(call, seconds)

    def recording_quota(self, user: str) -> RecordingQuota:
        """Return what the recordings of a user may have on one machine."""
        return RecordingQuota(self.limits.of(user).recording_bytes)

    async def ask_machine(self, machine: str, call: Call[R], seconds: float = ASK_TIMEOUT) -> R:
        """Make a call at a task set.

        Raises:
            Unavailable: It is away.
            TimedOut: It did not answer within `seconds`.
            RceError: It refused the call.
        """
        return await self._runner.dispatcher.ask(machine, call, seconds)

    def own_metrics(self) -> list[metrics.Family]:
        """Return the Master's own metrics."""
        return metrics.collect_families("master", lambda: inventory.families(self.presenter), self._runner.families)

    async def metrics_of(self, process: str) -> list[metrics.Family]:
        """Return the metrics of a process.

        Raises:
            Unavailable: It is not connected.
            TimedOut: It did not answer in time.
        """
        return (await self._runner.dispatcher.ask(process, ReadMetrics(), ASK_TIMEOUT)).families

    async def missing(self) -> list[str]:
        """Return sentences that say what the platform lacks to do its work."""
        return [*inventory.missing_parts(self.state), *await self._store.missing()]
