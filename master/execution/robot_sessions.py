"""Sessions of robots: login, resume, loss of the socket, and their end."""

from __future__ import annotations

import asyncio
import secrets

from master.access import guests
from master.access.audit import Audit, Origin
from master.access.grants import digest
from master.access.user_limits import UserLimits
from master.access.users import Users
from master.execution.effect_runner import EffectRunner, new_id, raise_first_error
from master.execution.lifecycle import Lifecycle
from master.graph import sessions
from master.graph.records import Process, Robot, ref
from master.live.view_cache import ViewCache
from rce.api.roles import Principal
from rce.control.calls.call import Nothing
from rce.control.calls.robots import LoggedIn, Login, SessionExpired, SocketStatus
from rce.control.connection import Handlers
from rce.errors import RceError
from rce.protocol.names import check_tag, is_guest


class RobotSessions:
    """Begins and ends the sessions of robots at the Robot endpoints."""

    def __init__(
        self,
        runner: EffectRunner,
        lifecycle: Lifecycle,
        users: Users,
        audit: Audit,
        limits: UserLimits,
        view_cache: ViewCache,
    ) -> None:
        self._runner = runner
        self._state = runner.state
        self._lifecycle = lifecycle
        self._users = users
        self._audit = audit
        self._limits = limits
        self._view_cache = view_cache

    def add_handlers(self, handlers: Handlers, process: Process) -> None:
        """Answer the calls of a Robot endpoint about its robots."""
        handlers.on(Login, lambda call: self._login(process, call))
        handlers.on(SessionExpired, lambda call: self._leave(process, call))
        handlers.on(SocketStatus, lambda call: self._socket_moved(process, call))

    async def _login(self, process: Process, call: Login) -> LoggedIn:
        owner, origin = call.owner or call.user, Origin("websocket", _host(call.address))
        action = "data.read" if is_guest(call.robot) else "robot.connect"
        with self._audit.auditing(action, call.user, f"{owner}/{call.robot}", origin) as noted:
            check_tag(call.user, "userID")
            noted.who = await self._users.check(call.user, call.secret, origin.address)
            noted.owner = owner
            await guests.check_login(self._users, noted.who, owner, call.robot)
            return await self._begin(process, call, noted.who, origin.address)

    async def _begin(self, process: Process, call: Login, principal: Principal, address: str) -> LoggedIn:
        """Begin a session, or resume an earlier one."""
        owner = call.owner or call.user
        token = secrets.token_hex(32)
        resume = digest(call.resume) if call.resume else ""
        events = "events" in call.features
        robot = Robot(f"{owner}/{call.robot}", process.name, digest(token), principal, address, events=events)
        outcome, resumed = sessions.robot_arrived(self._state, robot, resume, new_id, self._limits.of(owner))
        saved, running = self._runner.save(), self._runner.run(outcome.plan)
        # A DropRobot of an earlier session of this name may be under way to the endpoint: it must not end this one.
        await self._runner.dispatcher.settled(process.name, ref(robot))
        try:
            raise_first_error(await running)
        except RceError as error:  # the session stands: if it were refused now, the robot could not resume it
            self._runner.tell(owner, error=error.info)
        try:
            await saved
        except BaseException:  # as a full disk: nobody has the token of a new session, so its name must be free again
            present = self._state.robots.get(robot.name)
            if not resumed and present is not None and present.session == robot.session:
                self._lifecycle.apply(sessions.robot_left(self._state, robot.name))
            raise
        return LoggedIn(token, resumed)

    async def _leave(self, process: Process, call: SessionExpired) -> Nothing:
        robot = self._state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            self._lifecycle.apply(sessions.robot_left(self._state, call.robot))
        return Nothing()

    async def _socket_moved(self, process: Process, call: SocketStatus) -> Nothing:
        robot = self._state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            sessions.socket_moved(self._state, call.robot, call.connected)
            self._view_cache.mark("robots", call.robot)
        return Nothing()

    async def disconnect(self, robot: str, reason: str) -> None:
        """End a robot's session; return when its socket is closed, or its Robot endpoint is away."""
        plan = sessions.robot_dismissed(self._state, robot, reason)
        saved = self._runner.save()
        raise_first_error(await asyncio.shield(self._runner.run(plan)))
        await saved


def _host(peer: str) -> str:
    """Return the address in Autobahn's name of a peer, as tcp4:10.1.2.3:4567."""
    return peer.partition(":")[2].rpartition(":")[0]
