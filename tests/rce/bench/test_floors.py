"""Bare echoes, each with its server in a process of its own."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager

import pytest

from rce.bench import floors
from rce.bench.floors import Sample


@pytest.mark.parametrize("echo", [floors.tcp, floors.autobahn])
async def test_bare_echo_returns_messages_of_all_sizes(echo: Callable[[], AbstractAsyncContextManager[Sample]]) -> None:
    async with echo() as sample:
        for size in (1, 10_000, 10_000_000):
            assert 0 < await sample(size) < 30


def test_buffers_are_enlarged_in_both_directions() -> None:
    with socket.socket() as made:
        before = [made.getsockopt(socket.SOL_SOCKET, option) for option in (socket.SO_SNDBUF, socket.SO_RCVBUF)]
        floors.enlarge_buffers(made)
        after = [made.getsockopt(socket.SOL_SOCKET, option) for option in (socket.SO_SNDBUF, socket.SO_RCVBUF)]
    assert all(now > then for now, then in zip(after, before, strict=True))
