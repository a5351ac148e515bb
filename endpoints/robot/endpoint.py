"""The Robot endpoint: manages robots' sessions and handles the Master's calls about their interfaces."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Coroutine
from functools import partial
from itertools import islice
from typing import Literal
from weakref import WeakValueDictionary

from msgspec import Struct
from twisted.logger import Logger

from converters.definition import Definition
from endpoints.data.interface import Interface
from endpoints.data.port import DataPort
from endpoints.data.switchboard import Switchboard
from endpoints.robot.formats import Formats
from endpoints.robot.frame_receiver import ServerLimits
from endpoints.robot.handshake import LoginRequest
from endpoints.robot.kinds import make_interface
from endpoints.robot.session import RobotSession
from endpoints.robot.streams import Streams
from endpoints.robot.types import UserTypes
from endpoints.robot.video import SharedEncoders
from endpoints.robot.workers import Workers
from rce.control.calls.call import BatchResult
from rce.control.calls.endpoints import MAX_TEXT, InterfaceSpec, LinkLost, Sync
from rce.control.calls.robots import (
    Definitions,
    DescribeType,
    DropRobot,
    LoggedIn,
    Login,
    SendStatus,
    SessionExpired,
    SocketStatus,
    Sort,
)
from rce.control.client import ControlClient
from rce.control.connection import Handlers
from rce.errors import NotFound, RceError, Unavailable
from rce.net.budget import MB, Budget
from rce.process import logs
from rce.process.metrics import Family, gauge_family
from rce.protocol.blobs import Buffer
from rce.protocol.messages import DataMessage, DropEvent
from rce.protocol.names import parse_type

EXPIRY_RETRY = 1.0  # seconds
MAX_ROBOTS = 10_000  # without a session, whose streams are remembered
FORGET = 16  # robots at most that are forgotten at once
ENDED = "the session has ended"
LOGIN_WAIT = 5.0  # seconds for the Master to come back; shorter than robots wait, so that they get the reason

log = Logger()


class Options(Struct, frozen=True):
    """Options of a Robot endpoint; times in seconds, `queues` is the size of all messages that wait, in bytes.

    `converters` is the path of users' converters. `original_forwarders` says what Forwarders of robots without features
    carry.
    """

    limits: ServerLimits
    grace: float
    service_timeout: float
    queues: int = 512 * MB
    converters: str = ""
    original_forwarders: Literal["cdr", "ros1"] = "cdr"


class LoginResult(Struct, frozen=True):
    """Session of a robot that is logged in."""

    session: RobotSession
    token: str  # with which a later socket resumes the session
    resumed: bool


class RobotEndpoint:
    """Manager of robots' sessions, and their end of the data path.

    Attributes:
        master: Connection to the Master, set before robots are served.
        sessions: Sessions by the names of their robots.
        workers: Processes that convert large messages; to be closed at the end.
    """

    master: ControlClient

    def __init__(self, port: DataPort, options: Options) -> None:
        self.limits = options.limits
        self.grace = options.grace
        self._timeout = options.service_timeout
        self.switchboard = Switchboard(port, self._link_lost)
        self.workers = Workers(converters=options.converters)
        self._formats = Formats(original_forwarders=options.original_forwarders)
        self._encoders = SharedEncoders()
        self.sessions: dict[str, RobotSession] = {}
        self._queues = options.queues
        self._budget = Budget(options.queues)
        self._budgets: WeakValueDictionary[str, Budget] = WeakValueDictionary()  # by user
        self._types: dict[str, UserTypes] = {}  # by user: users do not see each other's types
        self._grace_timers: dict[str, asyncio.TimerHandle] = {}  # of sessions without a socket
        self._expiring: dict[str, asyncio.Task[None]] = {}
        self._known_away: set[str] = set()  # robots that were reported to have no socket
        self._tasks: set[asyncio.Task[None]] = set()
        self._incarnation = uuid.uuid4().hex  # of the streams: they are known as long as this object lives
        self._streams: dict[str, Streams] = {}  # by robot

    async def load_converters(self) -> None:
        """Find the users' converters.

        Raises:
            StartFailed: One cannot be loaded; the message has file, line and remedy.
        """
        found = await self.workers.converters()
        self._formats = Formats(found, self._formats.original_forwarders)
        for each in found:
            log.info("converter {name} for {type}", name=each.name, type=each.type)

    def handlers(self) -> Handlers:
        """Return the handlers of the Master's calls."""
        handlers = Handlers()
        handlers.on(Sync, self._sync)
        self.switchboard.add_to(handlers, self._make_interface)
        handlers.do(SendStatus, self._send_status)
        handlers.do(DropRobot, self._drop_robot)
        handlers.serve_metrics("robot", self.switchboard.families, self.workers.families, self._families)
        return handlers

    def _families(self) -> list[Family]:
        sessions = list(self.sessions.values())
        connected = sum(each.socket is not None for each in sessions)
        states: dict[tuple[str, ...], float] = {("connected",): connected, ("away",): len(sessions) - connected}
        queued = sum(each.outbox.waiting for each in sessions)
        return [
            gauge_family("rce_sessions", "Sessions of robots, with an open socket or away", ["state"], states),
            gauge_family("rce_queued_frames", "Messages, statuses and errors queued for robots", [], {(): queued}),
            gauge_family("rce_queued_bytes", "Bytes of messages that wait", [], {(): self._budget.used}),
        ]

    # --- robots -------------------------------------------------------------------------------------------------------

    async def login(self, request: LoginRequest) -> LoginResult:
        """Have the Master authenticate a robot; return its new or resumed session.

        Raises:
            RceError: The Master refuses the robot, or cannot be reached.
        """
        name = request.name
        connection = logs.set_request_id()
        if name in self._expiring:  # else the end of the old session would end the new one
            await asyncio.wait([self._expiring[name]])
        timer = self._grace_timers.pop(name, None)
        if timer is not None:
            timer.cancel()
        try:
            answer = await self._login_at_master(request)
        except BaseException:
            if timer is not None and name in self.sessions:
                self._start_grace(self.sessions[name], timer.when())
            raise
        session = self.sessions.get(name)
        if session is None or (session.token and not answer.resumed):
            session = self._create_session(name)
        session.features, session.connection = request.features, connection
        if name in self._grace_timers:
            self._grace_timers.pop(name).cancel()
        how = "resumed its session" if answer.resumed else "connected"
        log.info("robot {robot} {how} from {address}", robot=name, how=how, address=request.address)
        return LoginResult(session, answer.token, answer.resumed)

    async def _login_at_master(self, request: LoginRequest) -> LoggedIn:
        return await self.master.call(
            Login(
                request.user,
                request.robot,
                request.secret,
                request.resume,
                sorted(request.features),
                request.address,
                request.owner,
            ),
            wait=LOGIN_WAIT,
        )

    def _create_session(self, name: str) -> RobotSession:
        self._remove_session(name)
        streams, budget = self._streams_of(name), self._session_budget(name)
        session = self.sessions[name] = RobotSession(name, self.master, streams, budget, self.limits.message)
        self._start_grace(session)
        return session

    def _forget_robot(self, name: str, reason: str) -> RobotSession | None:
        self._known_away.discard(name)
        return self._remove_session(name, reason)

    def _remove_session(self, name: str, reason: str = ENDED) -> RobotSession | None:
        session = self.sessions.pop(name, None)
        if session is not None:
            session.end(reason)
            if session.streams.unused:
                del self._streams[name]
        return session

    def _streams_of(self, name: str) -> Streams:
        """Return the streams of a robot; those of the robot that has had no session for longest are forgotten."""
        streams = self._streams[name] = self._streams.pop(name, Streams(self._incarnation))
        for other in [each for each in islice(self._streams, FORGET) if each not in self.sessions and each != name]:
            if len(self._streams) > MAX_ROBOTS:
                del self._streams[other]
        return streams

    def _session_budget(self, name: str) -> Budget:
        """Return a new budget: a user may have a half of this process's bytes, a session a quarter."""
        user = name.partition("/")[0]
        budget = self._budgets.get(user)
        if budget is None:
            budget = self._budgets[user] = Budget(self._queues // 2, self._budget)
        return Budget(self._queues // 4, budget)

    def report_away(self) -> list[str]:
        """Return the names of the robots that have a session but no socket, which the caller reports to the Master."""
        away = [name for name, session in self.sessions.items() if session.socket is None]
        self._known_away.update(away)
        return away

    def connected(self, session: RobotSession) -> None:
        """Report to the Master that the robot has a socket, if the Master may regard it as away.

        A login makes it connected, but the report that its earlier socket was lost may arrive after the login.
        """
        if session.name in self._known_away:
            self._known_away.discard(session.name)
            self._start_task(self._report(SocketStatus(session.name, True)))

    def disconnected(self, session: RobotSession) -> None:
        """Report to the Master that the robot lost its socket, and start its grace time."""
        if self.sessions.get(session.name) is session:
            self._known_away.add(session.name)
            self._start_task(self._report(SocketStatus(session.name, False)))
            self._start_grace(session)

    def _start_grace(self, session: RobotSession, until: float | None = None) -> None:
        loop = asyncio.get_running_loop()
        if session.name in self._grace_timers:
            self._grace_timers[session.name].cancel()
        end = loop.time() + self.grace if until is None else until
        self._grace_timers[session.name] = loop.call_at(end, self._expire, session)

    def _expire(self, session: RobotSession) -> None:
        self._grace_timers.pop(session.name, None)
        if self.sessions.get(session.name) is session and session.socket is None:
            task = self._expiring[session.name] = asyncio.create_task(self._end_session(session))
            task.add_done_callback(lambda _: self._expiring.pop(session.name))

    def finished(self, session: RobotSession) -> None:
        """End a session without a grace time, because the robot closed its socket normally."""
        log.info("robot {robot} closed its connection: its session ends", robot=session.name)
        self._expire(session)

    async def _end_session(self, session: RobotSession) -> None:
        while self.sessions.get(session.name) is session and session.socket is None:
            try:
                await self.master.call(SessionExpired(session.name))
            except Unavailable:
                await asyncio.sleep(EXPIRY_RETRY)
                continue
            if self.sessions.get(session.name) is session and session.socket is None:
                self._forget_robot(session.name, "")
            return

    def data(self, session: RobotSession, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Pass a data message of a robot to its interface; return a task if its conversion takes longer.

        Raises:
            NotFound: The robot has no such interface.
        """
        interface = session.interfaces.get(message.iTag)
        if interface is None:
            raise NotFound(f"this robot has no interface {message.iTag[:80]!r}: add it first", field="iTag")
        return interface.from_robot(message, blobs)

    # --- the Master's calls -------------------------------------------------------------------------------------------

    async def _sync(self, call: Sync) -> BatchResult:
        for name in set(self.sessions) - set(call.robots):
            self._forget_robot(name, ENDED)
        return BatchResult(await self.switchboard.sync(call, self._make_interface))

    async def _make_interface(self, spec: InterfaceSpec) -> Interface:
        # Without a session the robot's login is in progress: the Master binds its interfaces before it answers.
        session = self.sessions.get(spec.owner) or self._create_session(spec.owner)
        user = spec.owner.partition("/")[0]
        types = self._types.setdefault(user, UserTypes(partial(self._describe_type, user)))
        registry = await types.registry_for(spec)
        return make_interface(
            spec, self.switchboard.hops, session, self.workers, registry, self._timeout, self._formats, self._encoders
        )

    async def definitions(self, user: str, type: str, sort: Sort) -> dict[str, Definition]:
        """Return the definition of a type of a user, its parts and the types in it, by name.

        Raises:
            UnknownType: Neither this endpoint nor an environment of the user has it.
        """
        types = self._types.setdefault(user, UserTypes(partial(self._describe_type, user)))
        name = parse_type(type)
        return (await types.registry_of(name, sort)).definitions(name, sort)

    async def _describe_type(self, user: str, name: str, sort: Sort) -> Definitions:
        return await self.master.call(DescribeType(user, name, sort))

    def _send_status(self, call: SendStatus) -> None:
        for session in filter(None, map(self.sessions.get, call.robots)):
            if isinstance(call.status, DropEvent):  # with those of the robot's own interfaces, and to every robot
                session.dropped(call.status.iTag, call.status.count, call.status.where)
            elif call.status is not None:
                session.status(call.status)
            if call.error is not None and "events" in session.features:
                session.error(RceError.from_info(call.error))

    def _drop_robot(self, call: DropRobot) -> None:
        session = self._forget_robot(call.robot, call.reason)
        if session is not None:
            for interface in list(session.interfaces.values()):
                self.switchboard.unbind(interface.spec.id)

    def _link_lost(self, link: str, reason: str) -> None:
        self._start_task(self._report(LinkLost(link, reason[:MAX_TEXT])))

    def _start_task(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _report(self, call: LinkLost | SocketStatus) -> None:
        try:
            await self.master.call(call)
        except RceError as error:  # made up for when this endpoint joins again, by its Hello and by Sync
            log.info("{call} could not be reported: {error}", call=type(call).__name__, error=str(error))
