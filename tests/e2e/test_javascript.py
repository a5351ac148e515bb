"""The JavaScript client at a real platform, in Node."""

from __future__ import annotations

import asyncio
from pathlib import Path

from chromium import chromium, opened
from node import node_command
from real_platform import RealPlatform

TRIAL = Path(__file__).parent.parent / "js" / "node_trial.mjs"


async def test_the_client_in_node(platform: RealPlatform) -> None:
    process = await asyncio.create_subprocess_exec(
        *node_command(), str(TRIAL), platform.url, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    try:
        out, err = await asyncio.wait_for(process.communicate(), 120)
    finally:
        if process.returncode is None:
            process.kill()
    assert process.returncode == 0, err.decode()
    assert "an environment is created, used and destroyed" in out.decode()


async def test_the_client_in_a_page(platform: RealPlatform) -> None:
    trial = TRIAL.with_name("trial.js").read_text()
    options = {"url": platform.url, "user": "testUser", "password": "testUser", "tag": "page"}
    async with chromium() as browser, opened(browser) as (page, _):
        await page.route("**/ui/trial.js", lambda route: route.fulfill(content_type="text/javascript", body=trial))
        await page.goto(f"{platform.url}ui/rce/rce.d.ts")  # any page of the origin
        run = """async (options) => {
            const rce = await import(`${options.url}ui/rce/rce.js`);
            return (await import(`${options.url}ui/trial.js`)).run(rce, options);
        }"""
        async with asyncio.timeout(120):
            assert "an environment is created, used and destroyed" in await page.evaluate(run, options)
