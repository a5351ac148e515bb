"""Uses of topics, services and actions."""

from __future__ import annotations

import asyncio
import gc

import pytest

from endpoints.gateways.uses import Use
from rce.errors import RceError


async def test_failure_that_nobody_asks_for_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    use = Use("u1", "/a", "std_msgs/String", lambda _: (), lambda *_: None)
    use.ready.set_exception(RceError("no environment"))
    del use
    gc.collect()
    assert caplog.records == []


async def test_use_ends_once_with_an_error() -> None:
    use = Use("u1", "/scan", "std_msgs/String", lambda _: (), lambda *_: None)
    ends: list[str] = []
    use.on_end(lambda error: ends.append(str(error)))
    use.ready.set_result(None)
    use.end(RceError("the robot removed it"))
    use.end(RceError("again"))
    use.cancel()
    await asyncio.sleep(0)
    assert ends == ["the robot removed it"]
    assert use.ready.exception() is None


async def test_use_of_a_client_that_left_does_not_end() -> None:
    use = Use("u1", "/scan", "std_msgs/String", lambda _: (), lambda *_: None)
    use.on_end(lambda error: pytest.fail(str(error)))
    use.cancel()
    await asyncio.sleep(0)
    assert use.ready.cancelled()
