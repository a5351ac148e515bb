"""Robots' sessions: how they begin and end, and what robots ask for in them."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable

from master import guests, presence
from master.audit import Audit, Origin
from master.grants import digest
from master.limits import Limits
from master.records import Process, Robot
from master.rim import Rim, ids
from master.sight import Sight
from master.users import Users
from rce.calls.call import Nothing
from rce.calls.robots import Execute, Leave, LoggedIn, Login, SocketMoved
from rce.control import Handlers
from rce.errors import NotFound, RceError
from rce.messages import Command
from rce.names import check_tag, is_guest
from rce.roles import Principal


class Sessions:
    """`execute` carries a user's command out: again, if it was under way when the Master was lost; last comes the
    robotID of the guest that commands it, empty if it is none.
    """

    def __init__(
        self,
        rim: Rim,
        users: Users,
        audit: Audit,
        limits: Limits,
        sight: Sight,
        execute: Callable[[str, Command, bool, str], Awaitable[Nothing]],
    ) -> None:
        self._rim = rim
        self._state = rim.state
        self._carrier = rim.carrier
        self._users = users
        self._audit = audit
        self._limits = limits
        self._sight = sight
        self._execute = execute

    def add_to(self, handlers: Handlers, process: Process) -> None:
        """What a Robot endpoint may ask."""
        handlers.on(Login, lambda call: self._login(process, call))
        handlers.on(Leave, lambda call: self._leave(process, call))
        handlers.on(SocketMoved, lambda call: self._socket_moved(process, call))
        handlers.on(Execute, lambda call: self._command(process, call))

    async def _login(self, process: Process, call: Login) -> LoggedIn:
        owner, origin = call.owner or call.user, Origin("websocket", _host(call.address))
        action = "data.read" if is_guest(call.robot) else "robot.connect"
        with self._audit.noting(action, call.user, f"{owner}/{call.robot}", origin) as noted:
            check_tag(call.user, "userID")
            noted.who = await self._users.check(call.user, call.secret, origin.address)
            noted.owner = owner
            await guests.check_login(self._users, noted.who, owner, call.robot)
            return await self._begin(process, call, noted.who, origin.address)

    async def _begin(self, process: Process, call: Login, principal: Principal, address: str) -> LoggedIn:
        """A session, or an earlier one again."""
        owner = call.owner or call.user
        token = secrets.token_hex(32)
        resume = digest(call.resume) if call.resume else ""
        robot = Robot(f"{owner}/{call.robot}", process.name, digest(token), principal, address)
        outcome, resumed = presence.robot_arrived(self._state, robot, resume, ids, self._limits.of(owner))
        saved = self._rim.save()
        try:
            await self._carrier.carry(outcome.plan)
        except RceError as error:  # the session stands without it: refused now, the robot could not come back
            self._rim.tell(owner, error=error.info)
        await saved
        return LoggedIn(token, resumed)

    async def _leave(self, process: Process, call: Leave) -> Nothing:
        robot = self._state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            self._rim.apply(presence.robot_left(self._state, call.robot))
        return Nothing()

    async def _socket_moved(self, process: Process, call: SocketMoved) -> Nothing:
        robot = self._state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            presence.socket_moved(self._state, call.robot, call.connected)
            self._sight.mark("robots", call.robot)
        return Nothing()

    async def disconnect(self, robot: str, reason: str) -> None:
        """End a robot's session; returns once its socket is closed, or its Robot endpoint is away."""
        plan = presence.robot_dismissed(self._state, robot, reason)
        saved = self._rim.save()
        await asyncio.shield(self._carrier.carry(plan))
        await saved

    async def _command(self, process: Process, call: Execute) -> Nothing:
        robot = self._state.robots.get(call.robot)
        if robot is None or robot.endpoint != process.name:
            raise NotFound(f"robot {call.robot} has no session at {process.name}")
        user, _, tag = call.robot.partition("/")
        command, origin = call.command, Origin("websocket", robot.address)
        about = guests.object_of(user, tag, command)
        with self._audit.noting(guests.operation(tag, command), user, about, origin) as noted:
            noted.who, noted.quiet = robot.by, guests.is_plumbing(tag, command)
            guests.check_command(robot.by, self._state, user, tag, command)
            return await self._execute(user, command, call.again, tag if is_guest(tag) else "")


def _host(peer: str) -> str:
    """The address in Autobahn's name of a peer, as tcp4:10.1.2.3:4567."""
    return peer.partition(":")[2].rpartition(":")[0]
