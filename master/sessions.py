"""Robots' sessions: how they begin and end, and what robots ask for in them."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable

from master import presence
from master.audit import Audit, Origin, object_of
from master.grants import digest
from master.limits import Limits
from master.records import Process, user_of
from master.rights import COMMANDS, check_command
from master.rim import Rim, ids
from master.users import Users, must_drive
from rce.calls.call import Nothing
from rce.calls.robots import Execute, Leave, LoggedIn, Login
from rce.control import Handlers
from rce.errors import NotFound, RceError
from rce.messages import Command
from rce.names import check_tag
from rce.roles import Principal


class Sessions:
    """`execute` carries a user's command out; True: again, it was under way when the Master was lost."""

    def __init__(
        self,
        rim: Rim,
        users: Users,
        audit: Audit,
        limits: Limits,
        execute: Callable[[str, Command, bool], Awaitable[Nothing]],
    ) -> None:
        self._rim = rim
        self._state = rim.state
        self._carrier = rim.carrier
        self._users = users
        self._audit = audit
        self._limits = limits
        self._execute = execute

    def add_to(self, handlers: Handlers, process: Process) -> None:
        """What a Robot endpoint may ask."""
        handlers.on(Login, lambda call: self._login(process, call))
        handlers.on(Leave, lambda call: self._leave(process, call))
        handlers.on(Execute, lambda call: self._command(process, call))

    async def _login(self, process: Process, call: Login) -> LoggedIn:
        origin, robot = Origin("websocket", _host(call.address)), f"{call.user}/{call.robot}"
        with self._audit.noting("robot.connect", call.user, robot, origin) as noted:
            check_tag(call.user, "userID")
            noted.who = await self._users.check(call.user, call.secret, origin.address)
            return await self._begin(process, call, noted.who, origin.address)

    async def _begin(self, process: Process, call: Login, principal: Principal, address: str) -> LoggedIn:
        """A session, or an earlier one again."""
        must_drive(principal, call.robot)
        token = secrets.token_hex(32)
        resume = digest(call.resume) if call.resume else ""
        outcome, resumed = presence.robot_arrived(
            self._state,
            *(call.user, call.robot, process.name, digest(token), resume, ids),
            *(self._limits.of(call.user), principal, address),
        )
        saved = self._rim.save()
        try:
            await self._carrier.carry(outcome.plan)
        except RceError as error:  # the session stands without it: refused now, the robot could not come back
            self._rim.tell(call.user, error=error.info)
        await saved
        return LoggedIn(token, resumed)

    async def _leave(self, process: Process, call: Leave) -> Nothing:
        robot = self._state.robots.get(call.robot)
        if robot is not None and robot.endpoint == process.name:
            self._rim.apply(presence.robot_left(self._state, call.robot))
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
        user, command = user_of(call.robot), call.command
        origin = Origin("websocket", robot.address)
        with self._audit.noting(COMMANDS[type(command)], user, object_of(user, command), origin) as noted:
            noted.who = robot.by
            check_command(robot.by, self._state, user, command)
            return await self._execute(user, command, call.again)


def _host(peer: str) -> str:
    """The address in Autobahn's name of a peer, as tcp4:10.1.2.3:4567."""
    return peer.partition(":")[2].rpartition(":")[0]
