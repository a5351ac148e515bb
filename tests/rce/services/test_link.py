"""Connection of a service to the Master: what it says when it joins, and what it announces."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from rce.control.calls.joining import Hello, Welcome
from rce.control.connection import Control, Handlers
from rce.control.credential import Credential, stay_joined
from rce.services.link import link_to_master
from tests.support.control import TIMEOUT, OpenJoiner, listening


class Joiner(OpenJoiner):
    """Joiner that keeps what was said."""

    def __init__(self) -> None:
        super().__init__()
        self.hellos: list[Hello] = []

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        self.hellos.append(hello)
        return await super().join(hello, address)


async def test_service_says_its_name_and_url_and_announces_that_it_is_ready(
    reactor: ReactorBase, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joiner, url = Joiner(), "http://:9020/"
    credential = Credential(tmp_path / "credential", "token")
    async with listening(reactor, joiner=joiner) as listener:
        link = link_to_master(reactor, listener.description, "x-service", url, credential, Handlers(), None)
        joined = asyncio.create_task(stay_joined(link, credential))
        control = await asyncio.wait_for(joiner.joined.get(), TIMEOUT)
        async with asyncio.timeout(TIMEOUT):
            while not link.connected:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        joined.cancel()
        await asyncio.wait_for(control.lost, TIMEOUT)
    (hello,) = joiner.hellos
    assert (hello.role, hello.name, hello.url, hello.token) == ("service", "x-service", url, "token")
    assert '"program": "x-service"' in capsys.readouterr().out.replace('":"', '": "')
    assert credential.secret == "credential"
