"""The JavaScript client in Node, at the fake platform; tests/e2e/test_javascript.py has it at a real one."""

from __future__ import annotations

import pytest

from tests.support.e2e.node import run_script
from tests.support.fake_platform import FakePlatform
from tests.support.paths import TESTS

NEED_REAL_PLATFORM = (
    "refused robots get the reason",
    "name in use is rejected",
    "environment is created used and destroyed",
    "goals end as their server says",
)
TIMEOUT = 60


@pytest.mark.slow
async def test_client_contract() -> None:
    async with FakePlatform() as platform:
        script = str(TESTS / "js" / "run_in_node.mjs")
        status, out, err = await run_script(script, platform.url, *NEED_REAL_PLATFORM, timeout=TIMEOUT)
    assert status == 0, err
    assert len(out.splitlines()) >= 8
