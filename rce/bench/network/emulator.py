"""Program that emulates a line: it passes packets between two TUN devices. Needs root.

One device is in this network namespace, the other in that of the robot, which it makes. Commands come as lines of
JSON on standard input (`Command`). The program ends with its standard input.
"""

from __future__ import annotations

import argparse
import asyncio
import fcntl
import os
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from random import Random

import msgspec

from rce.bench.network.line import PROFILES, Line
from rce.bench.network.namespaces import entered

_TUNSETIFF = 0x400454CA  # linux/if_tun.h
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
MTU = 1500


class Command(msgspec.Struct, frozen=True):
    """Interrupt the line (`up` false), or let packets pass again."""

    up: bool


def open_tun(name: str) -> int:
    """Make a TUN device in the namespace of this thread; return its file descriptor, which does not block.

    Raises:
        OSError: This process may not make one.
    """
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN | _IFF_NO_PI))
    except BaseException:
        os.close(device)
        raise
    return device


class Emulator:
    """Passes packets between two devices over a line each way."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.lines: list[Line] = []
        self._loop = loop

    def join(self, source: int, target: int, line: Line) -> None:
        """Pass packets from one device to another."""
        self.lines.append(line)
        self._loop.add_reader(source, self._read, source, target, line)

    def set_up(self, up: bool) -> None:
        """Interrupt the line, or let packets pass again."""
        for line in self.lines:
            line.up = up

    def _read(self, source: int, target: int, line: Line) -> None:
        with suppress(BlockingIOError):
            while True:
                packet = os.read(source, MTU + 100)
                now = self._loop.time()
                arrival = line.arrival(now, len(packet))
                if arrival is not None:
                    self._loop.call_at(arrival, self._deliver, target, packet, line)

    @staticmethod
    def _deliver(target: int, packet: bytes, line: Line) -> None:
        if line.up:
            with suppress(OSError):  # the device is going down: the packet is lost
                os.write(target, packet)


async def commands(obey: Callable[[Command], None]) -> None:
    """Obey the commands on standard input until its end."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    async for line in reader:
        obey(msgspec.json.decode(line, type=Command))


async def run(args: argparse.Namespace) -> None:
    """Make the devices, report that they exist, and pass packets until standard input ends."""
    profile = PROFILES[args.profile]
    near = open_tun(args.device)
    with entered(args.namespace):
        far = open_tun(args.device)
    random = Random(args.seed)
    emulator = Emulator(asyncio.get_running_loop())
    emulator.join(far, near, Line(profile.up, random))
    emulator.join(near, far, Line(profile.down, random))
    print("ready", flush=True)
    await commands(lambda command: emulator.set_up(command.up))


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--profile", choices=PROFILES, required=True)
    parser.add_argument("--device", required=True, help="name of both devices")
    parser.add_argument("--namespace", required=True, help="network namespace of the robot")
    parser.add_argument("--seed", type=int, default=1)
    asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    main()
