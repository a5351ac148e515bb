"""Lab: a network namespace for a robot, whose only way to this machine is an emulated line. Needs root."""

from __future__ import annotations

import asyncio
import itertools
import os
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import msgspec

from rce.bench.network.emulator import MTU, Command
from rce.bench.network.namespaces import IP, ip
from rce.errors import Unavailable

_numbers = itertools.count()


class Lab:
    """A robot's namespace and its line.

    Attributes:
        address: Address of this machine on the line.
        namespace: Network namespace of the robot.
    """

    def __init__(self, congestion: str) -> None:
        self._congestion = congestion
        number = next(_numbers)
        net = f"10.{64 + os.getpid() // 250 % 128}.{os.getpid() % 250}"
        self.address = f"{net}.1"
        self.namespace = f"rce-line-{os.getpid()}-{number}"
        self.device = f"rl{os.getpid() % 10**7}n{number}"
        self._robots = (f"{net}.{last}" for last in range(2, 255))
        self._robot = ""
        self._emulator: Process | None = None

    @property
    def prefix(self) -> tuple[str, ...]:
        """Words to put before a command, so that it runs in the robot's namespace."""
        return IP, "netns", "exec", self.namespace

    def set_up(self, up: bool) -> None:
        """Interrupt the line, or let packets pass again."""
        assert self._emulator is not None
        assert self._emulator.stdin is not None
        self._emulator.stdin.write(msgspec.json.encode(Command(up)) + b"\n")

    def move(self) -> None:
        """Give the robot another address, as a change of its network does."""
        last, self._robot = self._robot, next(self._robots)
        inside = ("-n", self.namespace)
        ip(*inside, "address", "add", f"{self._robot}/32", "dev", self.device)
        route = (f"{self.address}/32", "dev", self.device, "src", self._robot)
        ip(*inside, "route", "replace", *route, "congctl", self._congestion)
        if last:
            ip(*inside, "address", "delete", f"{last}/32", "dev", self.device)

    async def begin(self, profile: str) -> None:
        """Make the namespace and start the emulator.

        Raises:
            Unavailable: This process may not, or a program is missing.
        """
        ip("netns", "add", self.namespace)
        program = (sys.executable, "-P", "-m", "rce.bench.network.emulator")
        words = (f"--profile={profile}", f"--device={self.device}", f"--namespace={self.namespace}")
        self._emulator = await asyncio.create_subprocess_exec(*program, *words, stdin=PIPE, stdout=PIPE, stderr=PIPE)
        assert self._emulator.stdout is not None
        if await self._emulator.stdout.readline() != b"ready\n":
            _, said = await self._emulator.communicate()
            raise Unavailable(f"the line cannot be emulated: {said.decode().strip().rpartition(chr(10))[2]}")
        for inside in ((), ("-n", self.namespace)):
            ip(*inside, "link", "set", self.device, "mtu", str(MTU), "up")
        ip("-n", self.namespace, "link", "set", "lo", "up")
        ip("address", "add", f"{self.address}/24", "dev", self.device)
        self.move()

    async def end(self) -> None:
        """End the emulator and remove the namespace."""
        if self._emulator is not None:
            assert self._emulator.stdin is not None
            self._emulator.stdin.close()
            await self._emulator.wait()
        ip("netns", "delete", self.namespace)


@asynccontextmanager
async def lab(profile: str, congestion: str = "cubic") -> AsyncIterator[Lab]:
    """Make a lab with a line of this profile.

    Args:
        profile: Name of one of `PROFILES`.
        congestion: TCP congestion control of the robot.

    Raises:
        Unavailable: This process is not root, or a program is missing.
    """
    if os.geteuid() != 0:
        raise Unavailable("network namespaces and TUN devices need root: run this as root")
    made = Lab(congestion)
    try:
        await made.begin(profile)
        yield made
    finally:
        await made.end()
