"""The Robot endpoint: the sessions of its robots, and the Master's calls about their interfaces."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from functools import partial

from msgspec import Struct
from twisted.logger import Logger

from endpoints.data_port import DataPort
from endpoints.interface import Interface
from endpoints.robot.door import Admitted, Greeting, ServerLimits
from endpoints.robot.interfaces import make
from endpoints.robot.session import Session
from endpoints.robot.types import UserTypes
from endpoints.switchboard import Switchboard
from rce import logs
from rce.blobs import Buffer
from rce.calls.call import Settled
from rce.calls.endpoints import InterfaceSpec, LinkLost, Sync
from rce.calls.robots import Definitions, Describe, DropRobot, Leave, LoggedIn, Login, SocketMoved, Tell
from rce.control import Handlers, MasterLink
from rce.errors import NotFound, RceError, Unavailable
from rce.messages import DataMessage
from rce.metrics import Family, gauge

LEAVE_RETRY = 1.0
LOGIN_WAIT = 5.0  # for a Master that is away: less than robots wait, so that they hear the reason

log = Logger()


class Options(Struct, frozen=True):
    """Times in seconds."""

    limits: ServerLimits
    grace: float
    service_timeout: float


class RobotEndpoint:
    """See `endpoints.robot`. `master` is set before robots are let in."""

    master: MasterLink

    def __init__(self, port: DataPort, options: Options) -> None:
        self.limits = options.limits
        self.grace = options.grace
        self._timeout = options.service_timeout
        self.switchboard = Switchboard(port, self._link_lost)
        self.sessions: dict[str, Session] = {}
        self._types: dict[str, UserTypes] = {}  # by user: one user's types are no business of another's
        self._away: dict[str, asyncio.TimerHandle] = {}
        self._leaving: dict[str, asyncio.Task[None]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def handlers(self) -> Handlers:
        handlers = Handlers()
        handlers.on(Sync, self._sync)
        self.switchboard.add_to(handlers, self._make)
        handlers.do(Tell, self._tell)
        handlers.do(DropRobot, self._drop_robot)
        handlers.tell_metrics("robot", self.switchboard.families, self._families)
        return handlers

    def _families(self) -> list[Family]:
        sessions = list(self.sessions.values())
        connected = sum(each.socket is not None for each in sessions)
        states: dict[tuple[str, ...], float] = {("connected",): connected, ("away",): len(sessions) - connected}
        queued = sum(each.outbox.waiting for each in sessions)
        return [
            gauge("rce_sessions", "Robots with a session here, by whether their socket is open", ["state"], states),
            gauge("rce_queued_frames", "Messages, statuses and errors that wait for robots", [], {(): queued}),
        ]

    # --- robots -------------------------------------------------------------------------------------------------------

    async def login(self, greeting: Greeting) -> Admitted:
        name = greeting.name
        connection = logs.enter()
        if name in self._leaving:  # the Master must not end the session that it is about to give
            await asyncio.wait([self._leaving[name]])
        timer = self._away.pop(name, None)
        if timer is not None:
            timer.cancel()
        try:
            answer = await self._ask(greeting)
        except BaseException:
            if timer is not None and name in self.sessions:
                self._expect(self.sessions[name], timer.when())
            raise
        session = self.sessions.get(name)
        if session is None or (session.token and not answer.resumed):
            session = self._begin(name)
        session.features, session.connection = greeting.features, connection
        if name in self._away:
            self._away.pop(name).cancel()
        how = "resumes" if answer.resumed else "comes"
        log.info("robot {robot} {how} from {address}", robot=name, how=how, address=greeting.address)
        return Admitted(session, answer.token, answer.resumed)

    async def _ask(self, greeting: Greeting) -> LoggedIn:
        return await self.master.call(
            Login(
                greeting.user,
                greeting.robot,
                greeting.secret,
                greeting.resume,
                sorted(greeting.features),
                greeting.address,
                greeting.owner,
            ),
            wait=LOGIN_WAIT,
        )

    def _begin(self, name: str) -> Session:
        old = self.sessions.pop(name, None)
        if old is not None:
            old.end("the session is over")
        session = self.sessions[name] = Session(name, self.master)
        self._grace_begins(session)
        return session

    def away(self) -> list[str]:
        """The robots that have a session and no socket."""
        return [name for name, session in self.sessions.items() if session.socket is None]

    def connected(self, session: Session) -> None:
        """Its socket is open."""
        self._later(self._report(SocketMoved(session.name, True)))

    def disconnected(self, session: Session) -> None:
        """Its grace time begins."""
        if self.sessions.get(session.name) is session:
            self._later(self._report(SocketMoved(session.name, False)))
            self._grace_begins(session)

    def _grace_begins(self, session: Session) -> None:
        self._expect(session, asyncio.get_running_loop().time() + self.grace)

    def _expect(self, session: Session, until: float) -> None:
        if session.name in self._away:
            self._away[session.name].cancel()
        self._away[session.name] = asyncio.get_running_loop().call_at(until, self._grace_over, session)

    def _grace_over(self, session: Session) -> None:
        self._away.pop(session.name, None)
        if self.sessions.get(session.name) is session and session.socket is None:
            task = self._leaving[session.name] = asyncio.create_task(self._leave(session))
            task.add_done_callback(lambda _: self._leaving.pop(session.name))

    def finished(self, session: Session) -> None:
        """The robot has said goodbye: its session ends without a grace time."""
        log.info("robot {robot} leaves", robot=session.name)
        self._grace_over(session)

    async def _leave(self, session: Session) -> None:
        while self.sessions.get(session.name) is session and session.socket is None:
            try:
                await self.master.call(Leave(session.name))
            except Unavailable:
                await asyncio.sleep(LEAVE_RETRY)
                continue
            if self.sessions.get(session.name) is session and session.socket is None:
                del self.sessions[session.name]
                session.end("")
            return

    def data(self, session: Session, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        interface = session.interfaces.get(message.iTag)
        if interface is None:
            raise NotFound(f"this robot has no interface {message.iTag[:80]!r}: add it first", field="iTag")
        interface.from_robot(message, blobs)

    # --- the Master's calls -------------------------------------------------------------------------------------------

    async def _sync(self, call: Sync) -> Settled:
        for name in set(self.sessions) - set(call.robots):
            self.sessions.pop(name).end("the session is over")
        return Settled(await self.switchboard.sync(call, self._make))

    async def _make(self, spec: InterfaceSpec) -> Interface:
        # Without a session the robot's login is under way: the Master binds what it has before it answers.
        session = self.sessions.get(spec.owner) or self._begin(spec.owner)
        user = spec.owner.partition("/")[0]
        types = self._types.setdefault(user, UserTypes(partial(self._describe, user)))
        return make(spec, self.switchboard.watch, session, await types.of(spec), self._timeout)

    async def _describe(self, user: str, name: str, service: bool) -> Definitions:
        return await self.master.call(Describe(user, name, service))

    def _tell(self, call: Tell) -> None:
        session = self.sessions.get(call.robot)
        if session is not None:
            if call.status is not None:
                session.status(call.status)
            if call.error is not None and "events" in session.features:
                session.error(RceError.from_info(call.error))

    def _drop_robot(self, call: DropRobot) -> None:
        session = self.sessions.pop(call.robot, None)
        if session is not None:
            session.end(call.reason)
            for interface in list(session.interfaces.values()):
                self.switchboard.unbind(interface.spec.id)

    def _link_lost(self, link: str, reason: str) -> None:
        self._later(self._report(LinkLost(link, reason)))

    def _later(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _report(self, call: LinkLost | SocketMoved) -> None:
        try:
            await self.master.call(call)
        except RceError as error:  # when this endpoint joins again, its Hello says who is away, and Sync finds links
            log.info("{call} could not be reported: {error}", call=type(call).__name__, error=str(error))
