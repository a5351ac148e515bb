"""The Master at work: processes join it, robots' commands reach the graph, effects reach the processes."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine

from msgspec.structs import replace
from twisted.logger import Logger

import rce
from master import graph, presence, wiring
from master.carrier import Carrier
from master.effects import Plan, Send
from master.records import Environment, Process, State, user_of, what
from master.store import Store
from master.users import Processes, Users, digest, must_drive
from rce import calls as c
from rce.control import Control, Handlers
from rce.errors import ErrorInfo, InvalidRequest, NotFound, RceError, StartFailed, Unauthorized, UnknownType
from rce.messages import Command, EnvironmentEvent, NodeEvent, StatusData

START_TIMEOUT = 60.0
RETRY_FIRST, RETRY_MOST = 0.5, 30.0
STEADY = 5.0  # what ran this long before it died was no failed start: it is started again

log = Logger()


def ids() -> str:
    return secrets.token_hex(16)


class Master:
    """`grace` is how long a robot that lost its socket keeps its session, in seconds."""

    def __init__(self, store: Store, grace: float) -> None:
        self.state = State()
        self.users = Users(store)
        self.processes = Processes(store)
        self.grace = grace
        self._store = store
        self._carrier = Carrier(self._prepare, self._carried)
        self._retries: dict[str, float] = {}  # seconds to the next start of what keeps dying
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Take up where an earlier Master ended: processes join again, and who does not is gone after a while."""
        await self._store.load(self.state)
        for process in self.state.processes.by("robot"):
            self._later(2 * self.grace, lambda name=process.name: self._endpoint_away(name))  # type: ignore[misc]
        self._later(2 * self.grace, self._drop_stranded)

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
        )
        return c.Welcome(credential), self._handlers(process), lambda control: self._joined(process, hello, control)

    def _joined(self, process: Process, hello: c.Hello, control: Control) -> None:
        log.info("{role} {name} joined from {address}", role=process.role, name=process.name, address=control.address)
        old = self._carrier.controls.get(process.name)
        self._carrier.controls[process.name] = control
        if old is not None:
            old.close()
        control.lost.add_done_callback(lambda _: self._lost(process, control))
        self._apply(presence.joined(self.state, process, hello, ids))
        if process.role == "robot":
            self._later(self.grace, self._drop_stranded)

    def _lost(self, process: Process, control: Control) -> None:
        if self._carrier.controls.get(process.name) is not control:
            return  # it is back already
        del self._carrier.controls[process.name]
        log.info("{role} {name} is away", role=process.role, name=process.name)
        presence.left(self.state, process.name)
        if process.role == "robot":
            self._later(self.grace, lambda: self._endpoint_away(process.name))

    async def _endpoint_away(self, name: str) -> None:
        if name in self.state.joined:
            return
        plan, robots = presence.endpoint_gone(self.state, name)
        for robot in robots:
            plan += presence.robot_left(self.state, robot)
        self._apply(plan)

    async def _drop_stranded(self) -> None:
        plan: Plan = []
        for robot in presence.stranded(self.state):
            plan += presence.robot_left(self.state, robot)
        self._apply(plan)

    def _handlers(self, process: Process) -> Handlers:
        handlers = Handlers()
        if process.role == "robot":
            handlers.on(c.Login, lambda call: self._login(process, call))
            handlers.on(c.Leave, lambda call: self._leave(process, call))
            handlers.on(c.Execute, lambda call: self._execute(process, call))
            handlers.on(c.Describe, self._describe)
        elif process.role == "environment":
            handlers.on(c.NodeDied, lambda call: self._node_died(process, call))
            handlers.on(c.Report, self._report)
        else:
            handlers.on(c.EnvironmentDied, self._environment_died)
        handlers.on(c.LinkLost, self._link_lost)
        return handlers

    # --- robots -------------------------------------------------------------------------------------------------------

    async def _login(self, process: Process, call: c.Login) -> c.LoggedIn:
        principal = await self.users.check(call.user, call.secret)
        must_drive(principal)
        token = secrets.token_hex(32)
        resume = digest(call.resume) if call.resume else ""
        outcome, resumed = presence.robot_arrived(
            self.state, call.user, call.robot, process.name, digest(token), resume, ids
        )
        saved = self._save()
        await self._carrier.carry(outcome.plan)
        await saved
        return c.LoggedIn(token, resumed)

    async def _leave(self, process: Process, call: c.Leave) -> c.Nothing:
        robot = self.state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            self._apply(presence.robot_left(self.state, call.robot))
        return c.Nothing()

    async def _execute(self, process: Process, call: c.Execute) -> c.Nothing:
        robot = self.state.robots.get(call.robot)
        if robot is None or robot.endpoint != process.name:
            raise NotFound(f"robot {call.robot} has no session at {process.name}")
        return await self.execute(user_of(call.robot), call.command, call.again)

    async def execute(self, user: str, command: Command, again: bool = False) -> c.Nothing:
        """Carry a user's command out to its completion; what did not become real is taken back."""
        outcome = graph.execute(self.state, user, command, ids, again)
        saved = self._save()
        try:
            await self._carrier.carry(outcome.plan)
            for key in outcome.awaits:
                await self._carrier.wait(key, START_TIMEOUT)
        except RceError:
            for key in outcome.awaits:
                self._apply(graph.undo(self.state, key))
            raise
        await saved
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
        log.warn("environment {name} died: {reason}", name=call.name, reason=call.reason)
        if self._carrier.settle(what(environment), StartFailed(f"environment {call.name}: {call.reason}")):
            return c.Nothing()  # its first start: the command that waits takes it back
        lived = self._carrier.is_real(what(environment))
        for key in self._inside(environment):
            self._carrier.forget(key)
        self._apply(presence.environment_down(self.state, environment))
        kept = call.name in self.state.environments
        tag = call.name.partition("/")[2]
        self.tell(user_of(call.name), EnvironmentEvent(tag, "lost" if kept else "gone", call.reason))
        if kept:
            self._later(self._pause(call.name, lived), lambda: self._restart(call.name, call.run))
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
            start: Plan = [[Send(process.name, c.StartNode(node.spec), what(node))]]
            self._later(self._pause(node.key, True), lambda: self._start_again(node.key, start))
        return c.Nothing()

    async def _start_again(self, key: str, start: Plan) -> None:
        if key in self.state.nodes:
            self._apply(start)

    def _pause(self, key: str, lived: bool) -> float:
        """Seconds until the next start: more with each failure in a row."""
        pause = RETRY_FIRST if lived else min(RETRY_MOST, 2 * self._retries.get(key, RETRY_FIRST))
        self._retries[key] = pause
        return pause

    async def _report(self, call: c.Report) -> c.Nothing:
        self.tell(user_of(call.owner), error=call.error)
        return c.Nothing()

    async def _link_lost(self, call: c.LinkLost) -> c.Nothing:
        log.info("link {link} is lost: {reason}", link=call.link, reason=call.reason)
        self._apply(wiring.reopen(self.state, call.link, ids))
        return c.Nothing()

    # --- effects ------------------------------------------------------------------------------------------------------

    def _apply(self, plan: Plan) -> None:
        """Save what changed and carry the effects out; what fails is told to the user it concerns."""
        self._keep(self._save())
        task = self._carrier.carry(plan)
        task.add_done_callback(_log_error)

    def _save(self) -> asyncio.Task[None]:
        """Begin to write what changed; who waits for something that is gone hears so."""
        for table in self.state.tables():
            for key in table.changed:
                if key not in table:
                    name = f"{table.kind.__name__} {key}"
                    self._carrier.settle(name, NotFound(f"{name.lower()} was removed before it came up"))
        return asyncio.create_task(self._store.save(self.state))

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
        if not isinstance(send.call, c.Sync) or not isinstance(result, c.Settled):
            return
        sync, failed = send.call, result.failed
        for spec in sync.interfaces:
            interface = self.state.interfaces.get(f"{spec.owner}/{spec.tag}")
            if interface is not None and interface.spec.id == spec.id:
                self._conclude(what(interface), failed.get(spec.id), spec.owner)
        environment = self.state.environments.get(send.to)
        if environment is None:
            return
        for node in self.state.nodes.by(send.to):
            if node.spec in sync.nodes:
                self._conclude(what(node), failed.get(f"node:{node.spec.tag}"), send.to)
        for parameter in self.state.parameters.by(send.to):
            if parameter.spec in sync.parameters:
                self._conclude(what(parameter), failed.get(f"parameter:{parameter.spec.key}"), send.to)
        self._carrier.settle(what(environment))
        self.tell(user_of(send.to), EnvironmentEvent(send.to.partition("/")[2], "ready"))

    def _conclude(self, key: str, error: ErrorInfo | None, owner: str) -> None:
        if error is None:
            self._carrier.settle(key)
        elif not self._carrier.settle(key, RceError.from_info(error)):
            self.tell(user_of(owner), error=error)

    def _later(self, seconds: float, work: Callable[[], Coroutine[None, None, None]]) -> None:
        async def wait() -> None:
            await asyncio.sleep(seconds)
            await work()

        self._keep(asyncio.create_task(wait()))

    def _keep(self, task: asyncio.Task[None]) -> None:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(_log_error)


def _log_error(task: asyncio.Task[None]) -> None:
    if task.cancelled() or (error := task.exception()) is None:
        return
    if isinstance(error, RceError):
        log.warn("{error}", error=str(error))
    else:
        log.error("defect: {error!r}", error=error)
