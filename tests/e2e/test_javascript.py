"""The JavaScript client at a real platform, in Node and in a page."""

from __future__ import annotations

import asyncio

from tests.support.e2e.chromium import chromium, open_page, visit
from tests.support.e2e.node import run_script
from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import TESTS

RUNNER = TESTS / "js" / "run_in_node.mjs"


async def test_client_in_node(platform: RealPlatform) -> None:
    status, out, err = await run_script(str(RUNNER), platform.url, timeout=120)
    assert status == 0, err
    assert "environment is created used and destroyed" in out


async def test_client_in_a_page(platform: RealPlatform) -> None:
    contract = RUNNER.with_name("client_contract.js").read_text()
    options = {"url": platform.url, "user": "testUser", "password": "testUser", "tag": "page"}
    async with chromium() as browser, open_page(browser) as (page, _):
        await page.route(
            "**/ui/client_contract.js", lambda route: route.fulfill(content_type="text/javascript", body=contract)
        )
        await visit(page, f"{platform.url}ui/rce/rce.d.ts")  # any page of the same origin
        run = """async (options) => {
            const rce = await import(`${options.url}ui/rce/rce.js`);
            return (await import(`${options.url}ui/client_contract.js`)).run(rce, options);
        }"""
        async with asyncio.timeout(120):
            assert "environment is created used and destroyed" in await page.evaluate(run, options)
