"""Route of the C++ client: its program measures round trips beside those of the Python client, with the same nodes."""

from __future__ import annotations

import asyncio
import os
from asyncio.subprocess import PIPE, Process
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from rce.bench.floors import Sample
from rce.bench.nodes import ECHO_TIMEOUT, PACKAGE, Place, Probe, retry
from rce.bench.payloads import ROW, TOPICS
from rce.client.address import Address
from rce.errors import InvalidRequest, RceError, TimedOut

PROGRAM = "RCE_BENCH_CPP"
"""Variable with the path of `rce_round_trips`, an example of the C++ client."""
FORMS = ("json", "forwarder")


async def cpp(place: Place) -> list[Probe]:
    """Return the probes of a robot with the C++ client, each beside those of the routes r2c and r2r.

    Raises:
        InvalidRequest: The place has no address of the platform, or the program is not named.
    """
    if place.address is None:
        raise InvalidRequest("the route cpp needs the address of the platform")
    program = Path(os.environ.get(PROGRAM, ""))
    if not await asyncio.to_thread(program.is_file):
        raise InvalidRequest(
            "the route cpp needs the program rce_round_trips: build the C++ client with -DRCE_BUILD_EXAMPLES=ON and "
            f"name the program in {PROGRAM}"
        )
    echoes = " ".join(f"{payload.name}:{payload.kind}" for payload in TOPICS if payload.name in FORMS)
    await place.environment.add_node("cpp_echo", PACKAGE, "echo", args=echoes, namespace="cpp")
    client = await start(program, place.address, place.robot.name, place.environment.tag)
    place.stack.push_async_callback(client.stop)
    through = [Probe(f"cpp {form}", "topic", await client.sample(form), f"r2c {form}") for form in FORMS]
    direct = [Probe(f"cpp r2r {form}", "topic", await client.sample(f"r2r_{form}"), f"r2r {form}") for form in FORMS]
    return through + direct


class RoundTrips:
    """The program, which answers each line with the seconds of a round trip."""

    def __init__(self, process: Process) -> None:
        self._process = process

    async def sample(self, form: str) -> Sample:
        """Return the sample function of a form of messages, once there are answers."""
        await retry(lambda timeout: self._measure(form, ROW, timeout))
        return partial(self._measure, form, timeout=ECHO_TIMEOUT)

    async def _measure(self, form: str, size: int, timeout: float) -> float:  # noqa: ASYNC109  # the program's
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{form} {size} {timeout}\n".encode())
        line = (await self._process.stdout.readline()).strip()
        if not line:
            raise RceError(f"the C++ client ended with status {await self._process.wait()}")
        if line == b"late":
            raise TimedOut(f"the C++ client got no answer within {timeout:g} s")
        return float(line)

    async def stop(self) -> None:
        """End the program."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        await self._process.wait()


async def start(program: Path, address: Address, robot: str, environment: str) -> RoundTrips:
    """Start the program with the credentials of an address, as another robot."""
    secrets: Mapping[str, str] = {"RCE_PASSWORD": address.password or "", "RCE_KEY": address.key or ""}
    words = (str(program), address.url, address.user, f"{robot}_cpp", environment, "/cpp")
    process = await asyncio.create_subprocess_exec(*words, stdin=PIPE, stdout=PIPE, env={**os.environ, **secrets})
    return RoundTrips(process)
