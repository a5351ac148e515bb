"""The Master at work: processes join it, robots' commands reach the graph, effects reach the processes."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from typing import Any, Literal, TypeVar

from msgspec.structs import replace
from twisted.logger import Logger

import rce
from master import graph, packages, presence, wiring
from master.carrier import Carrier
from master.depot import FETCH_PATH, Depot
from master.effects import Plan, Send
from master.grants import digest
from master.limits import Limits
from master.pauses import Pauses
from master.placement import place
from master.policies import UNLIMITED, Policy
from master.records import Environment, Process, Robot, State, at, user_of, what
from master.rights import Principal
from master.shown import Shown
from master.store import Store
from master.users import Processes, Users, must_drive
from rce import calls as c
from rce.control import Control, Handlers
from rce.errors import (
    ErrorInfo,
    Forbidden,
    InvalidRequest,
    NoCapacity,
    NotFound,
    RceError,
    StartFailed,
    Unauthorized,
    Unavailable,
    UnknownType,
)
from rce.messages import Command, DestroyContainer, EnvironmentEvent, LimitEvent, NodeEvent, StatusData

START_TIMEOUT = 60.0
RETRY_FIRST, RETRY_MOST = 0.5, 30.0
LINK_RETRY_FIRST, LINK_RETRY_MOST = 0.1, 5.0
STEADY = 5.0  # what ran this long before it died was no failed start: it is started again

log = Logger()
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
        self.limits = Limits(store, policy)
        self.processes = Processes(store)
        self.grace = grace
        self.machine_grace = machine_grace
        self.entry = ("http", 0)
        self._depot = depot
        self._store = store
        self._carrier = Carrier(self._prepare, self._carried)
        self.shown = Shown(self.state, self._carrier.is_real)
        self._retries: dict[str, float] = {}  # seconds to the next start of what keeps dying
        self._breaks = Pauses(LINK_RETRY_FIRST, LINK_RETRY_MOST, STEADY)
        self._away: dict[str, asyncio.Task[None]] = {}  # processes whose time to come back runs
        self._reopening: set[str] = set()  # links that broke before, until they are opened again
        self._tasks: set[asyncio.Task[Any]] = set()

    async def start(self) -> None:
        """Take up where an earlier Master ended: processes join again, and who does not is gone after a while."""
        await self._store.load(self.state)
        await self.limits.open()
        self._keep(asyncio.create_task(self.limits.follow()))
        packages.drop_strays(self.state, set(await self.users.names()))
        self._sweep()
        for process in self.state.processes:
            self._expect(process, 2)
        self._drop_later(2 * self.grace)

    async def stop(self) -> None:
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._carrier.close()
        await self._save()

    # --- processes ----------------------------------------------------------------------------------------------------

    async def join(self, hello: c.Hello, address: str) -> tuple[c.Welcome, Handlers, Callable[[Control], None]]:
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
        return c.Welcome(credential), self._handlers(process), lambda control: self._joined(process, hello, control)

    def _joined(self, process: Process, hello: c.Hello, control: Control) -> None:
        log.info("{role} {name} joined from {address}", role=process.role, name=process.name, address=control.address)
        old = self._carrier.controls.get(process.name)
        self._carrier.controls[process.name] = control
        if old is not None:
            old.close()
        control.lost.add_done_callback(lambda _: self._lost(process, control))
        if process.name in self._away:
            self._away.pop(process.name).cancel()
        self._apply(presence.joined(self.state, process, hello, ids))
        self._drop_later(self.grace)
        if process.role == "container":
            self._refuse_waiting()

    def _lost(self, process: Process, control: Control) -> None:
        if self._carrier.controls.get(process.name) is not control:
            return  # it is back already
        del self._carrier.controls[process.name]
        log.info("{role} {name} is away", role=process.role, name=process.name)
        presence.left(self.state, process.name)
        if process.name in self.state.processes:
            self._expect(process)

    def _expect(self, process: Process, times: float = 1) -> None:
        """A process has its grace time, so many times, to come back."""
        name = process.name
        self.state.expected.add(name)
        if process.role == "robot":
            self._away[name] = self._later(times * self.grace, lambda: self._endpoint_away(name))
        else:
            self._away[name] = self._later(times * self.machine_grace, lambda: self._machine_away(name))

    async def _machine_away(self, name: str) -> None:
        """A task set or an environment's endpoint does not come back."""
        self._away.pop(name, None)
        self.state.expected.discard(name)
        for environment in presence.lost_with(self.state, name):
            away = f"its machine {environment.machine} has been away for {self.machine_grace:g} s"
            self._environment_down(environment, away)
        self._refuse_waiting()
        self._later(RETRY_FIRST, self._resettle)

    async def _resettle(self) -> None:
        """There may be room for environments that wait for a machine."""
        self._apply(presence.resettle(self.state, ids))

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
        plan, robots = presence.endpoint_gone(self.state, name)
        for robot in robots:
            plan += presence.robot_left(self.state, robot)
        self._apply(plan)

    def _drop_later(self, seconds: float) -> None:
        """Robots that have no endpoint now have this long to appear at one."""
        robots = presence.stranded(self.state)
        if robots:
            self._later(seconds, lambda: self._drop(robots))

    async def _drop(self, robots: list[Robot]) -> None:
        plan: Plan = []
        for robot in robots:
            if self.state.robots.get(robot.name) == robot:  # else it has come back, or even been stranded anew
                plan += presence.robot_left(self.state, robot.name)
        self._apply(plan)

    def _handlers(self, process: Process) -> Handlers:
        handlers = Handlers()
        if process.role == "robot":
            handlers.on(c.Login, lambda call: self._login(process, call))
            handlers.on(c.Leave, lambda call: self._leave(process, call))
            handlers.on(c.Execute, lambda call: self._execute(process, call))
            handlers.on(c.Describe, self._describe)
        elif process.role == "service":
            handlers.on(c.Vouch, self._vouch)
            handlers.on(c.Delegate, lambda call: self._delegate(process, call))
            handlers.on(c.Borrow, lambda call: self.users.grants.borrow(process.name, call.grant, call.seconds))
            handlers.on(c.EndGrant, lambda call: self._end_grant(process, call))
        elif process.role == "environment":
            handlers.on(c.NodeDied, lambda call: self._node_died(process, call))
            handlers.on(c.Report, lambda call: self._report(process, call))
        else:
            handlers.on(c.EnvironmentDied, self._environment_died)
            handlers.on(c.FetchPackage, lambda call: self._fetch_package(process, call))
            handlers.on(c.LimitReached, self._limit_reached)
        handlers.on(c.LinkLost, lambda call: self._link_lost(process, call))
        return handlers

    # --- services that act for users ----------------------------------------------------------------------------------

    async def _vouch(self, call: c.Vouch) -> c.Person:
        principal = await self._client(call.user, call.secret)
        return c.Person(principal.user, principal.role)

    async def _delegate(self, process: Process, call: c.Delegate) -> c.Grant:
        principal = await self._client(call.user, call.secret)
        return c.Grant(await self.users.grants.give(process.name, principal.user, principal.key))

    async def _end_grant(self, process: Process, call: c.EndGrant) -> c.Nothing:
        await self.users.grants.end(process.name, call.grant)
        return c.Nothing()

    async def _client(self, user: str, secret: str) -> Principal:
        """Who may have a service act as a robot of theirs: not a service that acts for somebody already."""
        principal = await self.users.check(user, secret)
        if principal.lent:
            raise Forbidden("this key was lent to a service and is for robots only")
        must_drive(principal)
        return principal

    # --- robots -------------------------------------------------------------------------------------------------------

    async def _login(self, process: Process, call: c.Login) -> c.LoggedIn:
        principal = await self.users.check(call.user, call.secret)
        must_drive(principal)
        token = secrets.token_hex(32)
        resume = digest(call.resume) if call.resume else ""
        outcome, resumed = presence.robot_arrived(
            self.state, call.user, call.robot, process.name, digest(token), resume, ids, self.limits.of(call.user)
        )
        saved = self._save()
        try:
            await self._carrier.carry(outcome.plan)
        except RceError as error:  # the session stands without it: refused now, the robot could not come back
            self.tell(call.user, error=error.info)
        await saved
        return c.LoggedIn(token, resumed)

    async def _leave(self, process: Process, call: c.Leave) -> c.Nothing:
        robot = self.state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            self._apply(presence.robot_left(self.state, call.robot))
        return c.Nothing()

    async def disconnect(self, robot: str, reason: str) -> None:
        """End a robot's session; returns once its socket is closed, or its Robot endpoint is away."""
        plan = presence.robot_dismissed(self.state, robot, reason)
        saved = self._save()
        await asyncio.shield(self._carrier.carry(plan))
        await saved

    async def _execute(self, process: Process, call: c.Execute) -> c.Nothing:
        robot = self.state.robots.get(call.robot)
        if robot is None or robot.endpoint != process.name:
            raise NotFound(f"robot {call.robot} has no session at {process.name}")
        return await self.execute(user_of(call.robot), call.command, call.again)

    async def execute(self, user: str, command: Command, again: bool = False) -> c.Nothing:
        """Carry a user's command out to its completion; what did not become real is taken back."""
        outcome = graph.execute(self.state, user, command, ids, again, self.limits.of(user))
        saved = self._save(by_command=True)
        expected = {key: self._carrier.expect(key) for key in outcome.awaits}
        try:
            await self._carrier.carry(outcome.plan)
            for key, future in expected.items():
                await self._carrier.wait(key, START_TIMEOUT, future)
        except RceError:
            if expected and all(future.done() and not future.exception() for future in expected.values()):
                return c.Nothing()  # a later command took it back while this one was on its way
            for future in expected.values():
                future.cancel()
            self._apply(graph.undo(self.state, outcome))
            raise
        await saved
        if isinstance(command, DestroyContainer):
            await self._resettle()
        return c.Nothing()

    async def _describe(self, call: c.Describe) -> c.Definitions:
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

    async def ask(self, environment: Environment, call: c.Call[R]) -> R:
        """Ask an environment, once it is there. TimedOut, Unavailable, and what the environment answers."""
        await self._carrier.wait(what(environment), START_TIMEOUT)
        control = self._carrier.controls.get(environment.name)
        if control is None:
            raise Unavailable(f"environment {environment.name} is away at present")
        return await control.call(call)

    def tell(self, user: str, status: StatusData | None = None, error: ErrorInfo | None = None) -> None:
        """A status or an error to all robots of a user; those without the feature `events` are spared."""
        for robot in self.state.robots.by(user):
            if robot.endpoint in self.state.joined:
                self._carrier.carry([[Send(robot.endpoint, c.Tell(robot.name, status, error), robot.name)]])

    # --- environments -------------------------------------------------------------------------------------------------

    async def _environment_died(self, call: c.EnvironmentDied) -> c.Nothing:
        environment = self.state.environments.get(call.name)
        if environment is None or environment.run != call.run:
            return c.Nothing()  # an earlier life
        lived = self._carrier.is_real(what(environment))
        self._environment_down(environment, call.reason)
        if call.name in self.state.environments:
            self._later(self._pause(call.name, lived), lambda: self._restart(call.name, call.run))
        else:
            await self._resettle()
        return c.Nothing()

    def _environment_down(self, environment: Environment, reason: str) -> None:
        name = environment.name
        log.warn("environment {name} died: {reason}", name=name, reason=reason)
        lived = self._carrier.is_real(what(environment))
        # A command that waits for its first start takes the environment back; then there is nothing to restart.
        self._carrier.settle(what(environment), StartFailed(f"environment {name}: {reason}"))
        for key in self._inside(environment):
            self._carrier.forget(key)
        self._apply(presence.environment_down(self.state, environment))
        kept = name in self.state.environments
        event: Literal["failed", "lost", "gone"] = "failed" if not lived else "lost" if kept else "gone"
        self.tell(user_of(name), EnvironmentEvent(name.partition("/")[2], event, reason))

    async def _limit_reached(self, call: c.LimitReached) -> c.Nothing:
        environment = self.state.environments.get(call.name)
        if environment is not None and environment.run == call.run:
            tag = call.name.partition("/")[2]
            self.tell(user_of(call.name), LimitEvent(f"environment {tag}: {call.reason}"))
        return c.Nothing()

    async def _restart(self, name: str, run: str) -> None:
        environment = self.state.environments.get(name)
        if environment is not None and environment.run == run:
            self._apply(presence.restart(self.state, environment, ids))

    def _inside(self, environment: Environment) -> list[str]:
        state, name = self.state, environment.name
        return [
            what(environment),
            *map(what, state.nodes.by(name)),
            *map(what, state.parameters.by(name)),
            *map(what, state.interfaces.by(name)),
            *map(what, wiring.connections_of(state, name)),
        ]

    async def _node_died(self, process: Process, call: c.NodeDied) -> c.Nothing:
        node = self.state.nodes.get(f"{process.name}/{call.node}")
        environment = self.state.environments.get(process.name)
        if node is None or environment is None:
            return c.Nothing()
        tag = process.name.partition("/")[2]
        self.tell(user_of(process.name), NodeEvent(tag, call.node, call.status, call.lines))
        if call.status == 0 or environment.options.restart == "no" or call.seconds < STEADY:
            self.state.nodes.drop(node.key)  # it has ended, or never worked: its tag is free
            self._apply([])
        else:
            self._later(RETRY_FIRST, lambda: self._start_again(node.key))
        return c.Nothing()

    async def _start_again(self, key: str) -> None:
        node = self.state.nodes.get(key)
        if node is None:
            return
        try:
            await self._carrier.carry([[Send(node.owner, c.StartNode(node.spec), what(node))]])
        except RceError as error:
            if self.state.nodes.get(key) == node:
                self.state.nodes.drop(key)
                self._apply([])
            self.tell(user_of(key), error=error.info)

    def _pause(self, key: str, lived: bool) -> float:
        """Seconds until the next start: more with each failure in a row."""
        pause = RETRY_FIRST if lived else min(RETRY_MOST, 2 * self._retries.get(key, RETRY_FIRST))
        self._retries[key] = pause
        return pause

    async def _report(self, process: Process, call: c.Report) -> c.Nothing:
        self.tell(user_of(process.name), error=call.error)  # an environment speaks to its own user only
        return c.Nothing()

    async def _link_lost(self, process: Process, call: c.LinkLost) -> c.Nothing:
        link = self.state.links.get(call.link)
        if link is None or process.name not in (link.listener, link.dialler) or call.link in self._reopening:
            return c.Nothing()
        log.info("link {link} is lost: {reason}", link=call.link, reason=call.reason)
        pause = self._breaks.after(f"{link.listener} {link.dialler} {link.alone_for}")
        if pause:
            self._reopening.add(call.link)
            self._later(pause, lambda: self._reopen(call.link))
        else:
            self._apply(wiring.reopen(self.state, call.link, ids))
        return c.Nothing()

    async def _reopen(self, link: str) -> None:
        self._reopening.discard(link)
        self._apply(wiring.reopen(self.state, link, ids))

    # --- users' packages ----------------------------------------------------------------------------------------------

    async def _fetch_package(self, process: Process, call: c.FetchPackage) -> c.Ticket:
        """A task set gets what its own environments are to see."""
        needed = any(
            call.digest in environment.packages for environment in self.state.environments.by(at(process.name))
        )
        if self._depot is None or not needed:
            raise NotFound(f"no environment of {process.name} has the package {call.digest[:80]}")
        token, size = self._depot.ticket(call.digest)
        scheme, port = self.entry
        return c.Ticket(scheme, port, FETCH_PATH, token, size)

    def _sweep(self) -> None:
        if self._depot is not None:
            self._depot.sweep(packages.named(self.state))

    # --- effects ------------------------------------------------------------------------------------------------------

    def _apply(self, plan: Plan) -> None:
        """Save what changed and carry the effects out; what fails is told to the user it concerns."""
        self._save()
        task = self._carrier.carry(plan)
        task.add_done_callback(_log_error)

    async def save(self) -> None:
        """Returns once all changes are safe. What users asked for by other ways than commands is saved by this."""
        await self._save()

    def _save(self, by_command: bool = False) -> asyncio.Task[None]:
        """Begin to write what changed; who waits for something that is gone hears so.

        What a command took back was carried out until then: who made it is answered well.
        """
        state = self.state
        if state.packages.changed or any(key not in state.environments for key in state.environments.changed):
            self._sweep()
        for table in self.state.tables():
            for key in table.changed:
                if key not in table:
                    name = f"{table.kind.__name__} {key}"
                    gone = f"{table.kind.__name__.lower()} {key} was removed before it came up"
                    self._carrier.settle(name, None if by_command else NotFound(gone))
                    self._carrier.forget(name)
        return self._keep(asyncio.create_task(self._store.save(self.state)))

    async def _prepare(self, send: Send) -> Send:
        """A new life of an environment gets a new join token, and its earlier ones can join no more."""
        call = send.call
        if not isinstance(call, c.StartEnvironment):
            return send
        token = secrets.token_hex(32)
        await self.processes.forget(call.environment.name)
        await self.processes.allow(call.environment.name, "environment", token)
        return replace(send, call=c.StartEnvironment(replace(call.environment, token=token)))

    def _carried(self, send: Send, result: object) -> None:
        match send.call, result:
            case c.Sync() as sync, c.Settled(failed):
                self._synced(send.to, sync, failed)
            case c.StartEnvironment(spec), RceError() as error:
                died = c.EnvironmentDied(spec.name, spec.run, str(error))
                self._keep(asyncio.create_task(self._environment_died(died)))

    def _synced(self, process: str, sync: c.Sync, failed: dict[str, ErrorInfo]) -> None:
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
        self.tell(user_of(process), EnvironmentEvent(process.partition("/")[2], "ready", address=environment.address))

    def _conclude(self, key: str, error: ErrorInfo | None, owner: str) -> None:
        if error is None:
            self._carrier.settle(key)
        elif not self._carrier.settle(key, RceError.from_info(error)):
            self.tell(user_of(owner), error=error)

    def _later(self, seconds: float, work: Callable[[], Coroutine[None, None, None]]) -> asyncio.Task[None]:
        async def wait() -> None:
            await asyncio.sleep(seconds)
            await work()

        return self._keep(asyncio.create_task(wait()))

    def _keep(self, task: asyncio.Task[T]) -> asyncio.Task[T]:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(_log_error)
        return task


def _log_error(task: asyncio.Task[Any]) -> None:
    if task.cancelled() or (error := task.exception()) is None:
        return
    if isinstance(error, RceError):
        log.warn("{error}", error=str(error))
    else:
        log.error("defect: {error!r}", error=error)
