"""Platforms in this process or of processes, and data links over each kind of connection."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from containers.data_relay import GATE, DataRelay
from endpoints.data.port import DataPort
from endpoints.robot.frame_receiver import ServerLimits
from rce.net.certificates import Authority
from rce.net.tls import Tls
from tests.support.certificates import certify
from tests.support.endpoints.ends import KEY, End, Listener
from tests.support.endpoints.platforms import Platform, Processes
from tests.support.endpoints.raw_robot import WAIT

MakePlatform = Callable[..., Any]


@pytest.fixture
async def make_platform(reactor: ReactorBase) -> AsyncIterator[MakePlatform]:
    made: list[Platform] = []

    async def make(*, grace: float = 10.0, service_timeout: float = 30.0, **limits: Any) -> Platform:
        platform = Platform(reactor, ServerLimits(**limits), grace, service_timeout)
        await platform.start()
        made.append(platform)
        return platform

    yield make
    for platform in made:
        await platform.stop()
    await asyncio.sleep(0)


@pytest.fixture
async def platform(make_platform: MakePlatform) -> Platform:
    made: Platform = await make_platform()
    return made


@pytest.fixture
async def processes(tmp_path: Path) -> AsyncIterator[Processes]:
    made = Processes(tmp_path)
    try:
        yield made
    finally:
        if hasattr(made, "port"):
            await made.close()
        await made.stop()


@pytest.fixture
def security(request: pytest.FixtureRequest) -> Tls | None:
    """TLS contexts, if the connection of this test has TLS."""
    found: Tls | None = None
    if "transport" in request.fixturenames and request.getfixturevalue("transport").endswith("tls"):
        found = request.getfixturevalue("tls")
    return found


@pytest.fixture
async def port(tmp_path: Path, security: Tls | None) -> AsyncIterator[tuple[Listener, list[str]]]:
    made = Listener(tls=security)
    yield made, await made.start(tmp_path)
    await made.close()


@pytest.fixture
async def relays(
    port: tuple[Listener, list[str]], tmp_path: Path, security: Tls | None
) -> AsyncIterator[tuple[str, Path]]:
    """Relays of two machines: the address of `port` by the far one, and the gate of an environment at the near one."""
    far, near = DataRelay(security), DataRelay(security)
    await far.listen("127.0.0.1", 0)
    for name, relay in (("far", far), ("near", near)):
        (tmp_path / name).mkdir()
        await relay.add_environment(f"ann/{name}", tmp_path / "data.sock", tmp_path / name)
    near.set_relays([far.address.removeprefix("relay:")])
    yield f"{far.address}/ann/far", tmp_path / "near" / GATE
    await near.close()
    await far.close()


@pytest.fixture(scope="session")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Tls:
    return Tls(certify(tmp_path_factory.mktemp("tls") / "own", Authority.make("test"), ["127.0.0.1"]))


@pytest.fixture(params=["unix", "tcp", "relay", "gate", "tcp with tls", "relay with tls", "gate with tls"])
def transport(request: pytest.FixtureRequest) -> str:
    """Kind of connection that carries a link."""
    chosen: str = request.param
    return chosen


@pytest.fixture
async def pair(
    transport: str, port: tuple[Listener, list[str]], relays: tuple[str, Path], security: Tls | None
) -> AsyncIterator[tuple[End, End]]:
    listener, addresses = port
    relayed, gate = relays
    here, there = End("here"), End("there")
    listener.expect(there.link, KEY)
    dialler = DataPort(gate) if transport.startswith("gate") else DataPort(tls=security)
    kind = "relay" if transport.startswith("gate") else transport.partition(" ")[0]
    await dialler.dial(here.link, KEY, [each for each in (*addresses, relayed) if each.startswith(kind)])
    await asyncio.wait_for(asyncio.gather(here.link.opened, there.link.opened), WAIT)
    yield here, there
    here.link.close()
    there.link.close()
    await asyncio.sleep(0)
