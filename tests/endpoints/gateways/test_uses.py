"""Uses of topics, services and actions."""

from __future__ import annotations

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
