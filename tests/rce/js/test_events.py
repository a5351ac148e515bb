"""Events of the JavaScript client."""

from __future__ import annotations

from tests.support.e2e.node import run_script
from tests.support.fake_platform import PASSWORD, FakePlatform
from tests.support.paths import TESTS

TIMEOUT = 60


async def test_events_end_with_their_loop_and_with_the_robot() -> None:
    async with FakePlatform() as platform:
        script = str(TESTS / "js" / "events.mjs")
        status, out, err = await run_script(script, platform.url, "testUser", PASSWORD, timeout=TIMEOUT)
    assert (status, out) == (0, "done\n"), err
