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
from master import graph, inventory, packages, presence, wiring
from master.audit import Audit, Origin, object_of
from master.carrier import Carrier
from master.depot import FETCH_PATH, Depot
from master.effects import Plan, Send
from master.events import Events
from master.feed import Feed
from master.gauges import Gauges
from master.grants import digest
from master.guard import Guard
from master.lending import Lending
from master.lifecycle import RETRY_FIRST, STEADY, Lifecycle
from master.limits import Limits
from master.pauses import Pauses
from master.placement import place
from master.policies import UNLIMITED, Policy
from master.processes import Processes
from master.records import Environment, Process, Robot, State, at, user_of, what
from master.rights import COMMANDS, check_command
from master.rim import Rim
from master.shown import Shown
from master.sight import Sight
from master.store import Store
from master.tracing import Tracer
from master.users import Users, must_drive
from rce import metrics
from rce.calls.call import Call, Nothing, Settled
from rce.calls.endpoints import LinkLost, Report, Sync
from rce.calls.environments import EnvironmentDied, FetchPackage, StartEnvironment, Ticket
from rce.calls.joining import Hello, Welcome
from rce.calls.robots import Definitions, Describe, Execute, Leave, LoggedIn, Login
from rce.calls.watching import ReadMetrics
from rce.control import Control, Handlers
from rce.errors import (
    ErrorInfo,
    InvalidRequest,
    NoCapacity,
    NotFound,
    RceError,
    Unauthorized,
    Unavailable,
    UnknownType,
)
from rce.messages import Command, DestroyContainer, EnvironmentEvent
from rce.names import check_tag
from rce.roles import Principal

START_TIMEOUT = 60.0
ASK_TIMEOUT = 5.0
LINK_RETRY_FIRST, LINK_RETRY_MOST = 0.1, 5.0

log = Logger()
_commands = metrics.Timing("rce_command_seconds", "Time until a command was complete", "command")
R = TypeVar("R")
T = TypeVar("T")


def ids() -> str:
    return secrets.token_hex(16)


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
        self.grace = grace
        self.machine_grace = machine_grace
        self.entry = ("http", 0)
        self._depot = depot
        self._store = store
        self._carrier = Carrier(self._prepare, self._carried)
        self._rim = Rim(self.state, store, self._carrier, self._sweep)
        self._lives = Lifecycle(self._rim, ids, self._resettle)
        self.shown = Shown(self.state, self._carrier.is_real)
        self.guard = Guard(self.users, self.state, self._rim.apply)
        self.gauges = Gauges(self.state, self._carrier, self.shown)
        self.tracer = Tracer(self.state, self._carrier)
        self.feed = Feed(Sight(self.shown, self._carrier), self.gauges.watch)
        self.events = Events(self.state)
        self._rim.listeners.append(self.events.told)
        self._breaks = Pauses(LINK_RETRY_FIRST, LINK_RETRY_MOST, STEADY)
        self._away: dict[str, asyncio.Task[None]] = {}  # processes whose time to come back runs
        self._reopening: set[str] = set()  # links that broke before, until they are opened again

    async def start(self) -> None:
        """Take up where an earlier Master ended: processes join again, and who does not is gone after a while."""
        await self._store.load(self.state)
        await self.limits.open()
        self._rim.keep(asyncio.create_task(self.limits.follow()))
        self._rim.keep(asyncio.create_task(self.guard.follow()))
        packages.drop_strays(self.state, set(await self.users.names()))
        self._sweep()
        for process in self.state.processes:
            self._expect(process, 2)
        self._drop_later(2 * self.grace)

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
        return Welcome(credential), self._handlers(process), lambda control: self._joined(process, hello, control)

    def _joined(self, process: Process, hello: Hello, control: Control) -> None:
        log.info("{role} {name} joined from {address}", role=process.role, name=process.name, address=control.address)
        old = self._carrier.controls.get(process.name)
        self._carrier.controls[process.name] = control
        if old is not None:
            old.close()
        control.lost.add_done_callback(lambda _: self._lost(process, control))
        if process.name in self._away:
            self._away.pop(process.name).cancel()
        self.events.process_moved(process, True)
        self._rim.apply(presence.joined(self.state, process, hello, ids))
        self.feed.sight.process_moved(process.name)
        self._drop_later(self.grace)
        if process.role == "container":
            self._refuse_waiting()

    def _lost(self, process: Process, control: Control) -> None:
        if self._carrier.controls.get(process.name) is not control:
            return  # it is back already
        del self._carrier.controls[process.name]
        log.info("{role} {name} is away", role=process.role, name=process.name)
        self.events.process_moved(process, False)
        presence.left(self.state, process.name)
        self.feed.sight.process_moved(process.name)
        if process.name in self.state.processes:
            self._expect(process)

    def _expect(self, process: Process, times: float = 1) -> None:
        """A process has its grace time, so many times, to come back."""
        name = process.name
        self.state.expected.add(name)
        if process.role == "robot":
            self._away[name] = self._rim.later(times * self.grace, lambda: self._endpoint_away(name))
        else:
            self._away[name] = self._rim.later(times * self.machine_grace, lambda: self._machine_away(name))

    async def _machine_away(self, name: str) -> None:
        """A task set or an environment's endpoint does not come back."""
        self._away.pop(name, None)
        self.state.expected.discard(name)
        self.feed.sight.process_moved(name)
        for environment in presence.lost_with(self.state, name):
            away = f"its machine {environment.machine} has been away for {self.machine_grace:g} s"
            self._lives.down(environment, away)
        self._refuse_waiting()
        self._rim.later(RETRY_FIRST, self._resettle)

    async def _resettle(self) -> None:
        """There may be room for environments that wait for a machine."""
        self._rim.apply(presence.resettle(self.state, ids))

    def _refuse_waiting(self) -> None:
        """What waits to be made on a machine that was expected back, and is not any more, is not made."""
        for environment in self.state.environments.by(at("")):
            try:
                place(self.state, user_of(environment.name), environment.options)
            except NoCapacity as error:
                self._carrier.settle(what(environment), error)

    async def _endpoint_away(self, name: str) -> None:
        self._away.pop(name, None)
        self.state.expected.discard(name)
        self.feed.sight.process_moved(name)
        plan, robots = presence.endpoint_gone(self.state, name)
        for robot in robots:
            plan += presence.robot_left(self.state, robot)
        self._rim.apply(plan)

    def _drop_later(self, seconds: float) -> None:
        """Robots that have no endpoint now have this long to appear at one."""
        robots = presence.stranded(self.state)
        if robots:
            self._rim.later(seconds, lambda: self._drop(robots))

    async def _drop(self, robots: list[Robot]) -> None:
        plan: Plan = []
        for robot in robots:
            if self.state.robots.get(robot.name) == robot:  # else it has come back, or even been stranded anew
                plan += presence.robot_left(self.state, robot.name)
        self._rim.apply(plan)

    def _handlers(self, process: Process) -> Handlers:
        handlers = Handlers()
        if process.role == "robot":
            handlers.on(Login, lambda call: self._login(process, call))
            handlers.on(Leave, lambda call: self._leave(process, call))
            handlers.on(Execute, lambda call: self._execute(process, call))
            handlers.on(Describe, self._describe)
        elif process.role == "service":
            Lending(self.users, self.audit).add_to(handlers, process)
        elif process.role == "environment":
            self._lives.of_environment(handlers, process)
            handlers.on(Report, lambda call: self._report(process, call))
        else:
            self._lives.of_machine(handlers)
            handlers.on(FetchPackage, lambda call: self._fetch_package(process, call))
        handlers.on(LinkLost, lambda call: self._link_lost(process, call))
        return handlers

    # --- robots -------------------------------------------------------------------------------------------------------

    async def _login(self, process: Process, call: Login) -> LoggedIn:
        origin, robot = Origin("websocket", _host(call.address)), f"{call.user}/{call.robot}"
        with self.audit.noting("robot.connect", call.user, robot, origin) as noted:
            check_tag(call.user, "userID")
            noted.who = await self.users.check(call.user, call.secret, origin.address)
            return await self._begin(process, call, noted.who, origin.address)

    async def _begin(self, process: Process, call: Login, principal: Principal, address: str) -> LoggedIn:
        """A session, or an earlier one again."""
        must_drive(principal, call.robot)
        token = secrets.token_hex(32)
        resume = digest(call.resume) if call.resume else ""
        outcome, resumed = presence.robot_arrived(
            self.state,
            *(call.user, call.robot, process.name, digest(token), resume, ids),
            *(self.limits.of(call.user), principal, address),
        )
        saved = self._rim.save()
        try:
            await self._carrier.carry(outcome.plan)
        except RceError as error:  # the session stands without it: refused now, the robot could not come back
            self._rim.tell(call.user, error=error.info)
        await saved
        return LoggedIn(token, resumed)

    async def _leave(self, process: Process, call: Leave) -> Nothing:
        robot = self.state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            self._rim.apply(presence.robot_left(self.state, call.robot))
        return Nothing()

    async def disconnect(self, robot: str, reason: str) -> None:
        """End a robot's session; returns once its socket is closed, or its Robot endpoint is away."""
        plan = presence.robot_dismissed(self.state, robot, reason)
        saved = self._rim.save()
        await asyncio.shield(self._carrier.carry(plan))
        await saved

    async def _execute(self, process: Process, call: Execute) -> Nothing:
        robot = self.state.robots.get(call.robot)
        if robot is None or robot.endpoint != process.name:
            raise NotFound(f"robot {call.robot} has no session at {process.name}")
        user, command = user_of(call.robot), call.command
        origin = Origin("websocket", robot.address)
        with self.audit.noting(COMMANDS[type(command)], user, object_of(user, command), origin) as noted:
            noted.who = robot.by
            check_command(robot.by, self.state, user, command)
            return await self.execute(user, command, call.again)

    async def execute(self, user: str, command: Command, again: bool = False) -> Nothing:
        """Carry a user's command out to its completion; what did not become real is taken back."""
        began = time.perf_counter()
        outcome = graph.execute(self.state, user, command, ids, again, self.limits.of(user))
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
            await self._resettle()
        return Nothing()

    async def _describe(self, call: Describe) -> Definitions:
        """Ask the user's environments, those that are starting once they are there."""
        for environment in self.state.environments.by(call.user):
            try:
                await self._carrier.wait(what(environment), START_TIMEOUT)
                control = self._carrier.controls.get(environment.name)
                if control is not None:
                    return await control.call(call)
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

    async def metrics_of(self, process: str) -> list[metrics.Family]:
        """What a process counts of itself. Unavailable, TimedOut."""
        return (await self._carrier.ask(process, ReadMetrics(), ASK_TIMEOUT)).families

    async def missing(self) -> list[str]:
        """What the platform lacks to do what it is for, in sentences."""
        return [*inventory.lacking(self.state), *await self._store.missing()]

    # --- environments -------------------------------------------------------------------------------------------------

    async def _report(self, process: Process, call: Report) -> Nothing:
        self._rim.tell(user_of(process.name), error=call.error)  # an environment speaks to its own user only
        return Nothing()

    async def _link_lost(self, process: Process, call: LinkLost) -> Nothing:
        link = self.state.links.get(call.link)
        if link is None or process.name not in (link.listener, link.dialler) or call.link in self._reopening:
            return Nothing()
        log.info("link {link} is lost: {reason}", link=call.link, reason=call.reason)
        pause = self._breaks.after(f"{link.listener} {link.dialler} {link.alone_for}")
        if pause:
            self._reopening.add(call.link)
            self._rim.later(pause, lambda: self._reopen(call.link))
        else:
            self._rim.apply(wiring.reopen(self.state, call.link, ids))
        return Nothing()

    async def _reopen(self, link: str) -> None:
        self._reopening.discard(link)
        self._rim.apply(wiring.reopen(self.state, link, ids))

    # --- users' packages ----------------------------------------------------------------------------------------------

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

    def _sweep(self) -> None:
        if self._depot is not None:
            self._depot.sweep(packages.named(self.state))

    async def save(self) -> None:
        """Returns once all changes are safe. What users asked for by other ways than commands is saved by this."""
        await self._rim.save()

    # --- effects ------------------------------------------------------------------------------------------------------

    async def _prepare(self, send: Send) -> Send:
        """A new life of an environment gets a new join token, and its earlier ones can join no more."""
        call = send.call
        if not isinstance(call, StartEnvironment):
            return send
        token = secrets.token_hex(32)
        await self.processes.forget(call.environment.name)
        await self.processes.allow(call.environment.name, "environment", token)
        return replace(send, call=StartEnvironment(replace(call.environment, token=token)))

    def _carried(self, send: Send, result: object) -> None:
        match send.call, result:
            case Sync() as sync, Settled(failed):
                self._synced(send.to, sync, failed)
            case StartEnvironment(spec), RceError() as error:
                died = EnvironmentDied(spec.name, spec.run, str(error))
                self._rim.keep(asyncio.create_task(self._lives.died(died)))

    def _synced(self, process: str, sync: Sync, failed: dict[str, ErrorInfo]) -> None:
        links = {route.link for route in sync.routes}
        for spec in sync.interfaces:
            interface = self.state.interfaces.get(f"{spec.owner}/{spec.tag}")
            if interface is not None and interface.spec.id == spec.id:
                self._conclude(what(interface), failed.get(spec.id), spec.owner)
                for connection in self.state.connections.by(interface.key):
                    if connection.link in links:
                        self._carrier.settle(what(connection))
        environment = self.state.environments.get(process)
        if environment is None:
            return
        for node in self.state.nodes.by(process):
            if node.spec in sync.nodes:
                self._conclude(what(node), failed.get(f"node:{node.spec.tag}"), process)
        for parameter in self.state.parameters.by(process):
            if parameter.spec in sync.parameters:
                self._conclude(what(parameter), failed.get(f"parameter:{parameter.spec.key}"), process)
        self._carrier.settle(what(environment))
        self._rim.tell(
            user_of(process), EnvironmentEvent(process.partition("/")[2], "ready", address=environment.address)
        )

    def _conclude(self, key: str, error: ErrorInfo | None, owner: str) -> None:
        if error is None:
            self._carrier.settle(key)
        elif not self._carrier.settle(key, RceError.from_info(error)):
            self._rim.tell(user_of(owner), error=error)


def _host(peer: str) -> str:
    """The address in Autobahn's name of a peer, as tcp4:10.1.2.3:4567."""
    return peer.partition(":")[2].rpartition(":")[0]
