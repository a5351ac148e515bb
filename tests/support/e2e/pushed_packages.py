"""Packages that users push: the command, and calls of their services."""

from __future__ import annotations

import asyncio
from typing import Any

from rce.client import Environment
from tests.support.e2e.real_platform import RCE
from tests.support.e2e.traffic import call

STRING_ECHO = "Test/StringEcho"


async def rce(*words: str, stdin: str = "") -> str:
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(RCE, *words, stdin=pipe, stdout=pipe, stderr=pipe)
    out, errors = await asyncio.wait_for(process.communicate(stdin.encode()), 150)
    assert process.returncode == 0, errors.decode()
    return out.decode()


async def echo(environment: Environment) -> None:
    """Call the node's service, whose type only the package defines."""
    assert await answer(environment, "/stringEchoService", STRING_ECHO, {"data": "hello"}) == {"data": "hello"}


async def answer(environment: Environment, name: str, type_name: str, request: dict[str, str]) -> Any:
    """Call a service of a node, which may still be starting."""
    service = await environment.service_client(name, type_name)
    found = await call(service, request, 120)
    await service.close()
    return found
