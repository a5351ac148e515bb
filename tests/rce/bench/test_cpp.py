"""Route of the C++ client, whose program a test plays."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import NamedTuple

import pytest

from rce.bench.cpp import PROGRAM, cpp
from rce.client.address import Address
from rce.errors import InvalidRequest, RceError
from tests.support.bench import fake_place

FAKE = """#!{python}
import os, sys
print(*sys.argv[1:], os.environ["RCE_PASSWORD"], file=open({log!r}, "w"))
for number, line in enumerate(sys.stdin):
    if line.startswith("json 13"):
        sys.exit(3)
    print("late" if number == 0 else int(line.split()[1]) / 1e6, flush=True)
"""


class Named(NamedTuple):
    name: str


@pytest.fixture
async def stack() -> AsyncIterator[AsyncExitStack]:
    async with AsyncExitStack() as stack:
        yield stack


async def test_program_measures_beside_the_python_client(
    stack: AsyncExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, log = tmp_path / "rce_round_trips", tmp_path / "log"
    program.write_text(FAKE.format(python=sys.executable, log=str(log)))
    program.chmod(0o755)
    monkeypatch.setenv(PROGRAM, str(program))
    place, *_ = fake_place(stack)
    address = Address("http://h/", "ann", "", "secret")
    probes = await cpp(place._replace(address=address, robot=Named("bench_1")))  # type: ignore[arg-type]
    assert [(each.name, each.beside) for each in probes] == [
        ("cpp json", "r2c json"),
        ("cpp forwarder", "r2c forwarder"),
        ("cpp r2r json", "r2r json"),
        ("cpp r2r forwarder", "r2r forwarder"),
    ]
    assert await probes[0].sample(5000) == 0.005
    assert log.read_text().split() == ["http://h/", "ann", "bench_1_cpp", place.environment.tag, "/cpp", "secret"]
    with pytest.raises(RceError, match="the C\\+\\+ client ended with status 3"):
        await probes[0].sample(13)


async def test_program_must_be_named(stack: AsyncExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(PROGRAM, raising=False)
    place, *_ = fake_place(stack)
    with pytest.raises(InvalidRequest, match="needs the address"):
        await cpp(place)
    with pytest.raises(InvalidRequest, match="name the program in RCE_BENCH_CPP"):
        await cpp(place._replace(address=Address("http://h/", "ann", "", "secret")))
