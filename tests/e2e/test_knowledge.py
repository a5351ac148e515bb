"""The knowledge service in a real platform: command line, rights, limits of queries, and its death."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from rce.api.knowledge import EntryChange
from rce.client.knowledge import KnowledgeClient
from rce.errors import InvalidRequest, RceError, Unauthorized
from tests.support.e2e.chromium import chromium, open_page, screenshot, sign_in, visit
from tests.support.e2e.real_platform import RCE, USER, RealPlatform
from tests.support.knowledge import BED, CUP, new_entry

TIMEOUT = 120.0  # seconds
SERVICE = r"-m rce\.knowledge "


async def rce(platform: RealPlatform, *words: str | Path) -> str:
    """Run a command that succeeds, and return its output."""
    pipe = asyncio.subprocess.PIPE
    command = (RCE, "knowledge", *map(str, words), "--url", platform.url)
    process = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=pipe)
    output, errors = await asyncio.wait_for(process.communicate(), TIMEOUT)
    assert process.returncode == 0, errors.decode()
    return output.decode()


async def test_robots_share_knowledge_over_the_command_line(platform: RealPlatform, tmp_path: Path) -> None:
    text = tmp_path / "cup.ttl"
    text.write_text(CUP)
    await rce(platform, "add", "object", "cup.blue", text, "--public", "--file", text)
    found = json.loads(await rce(platform, "search", "--class", "Vessel", "--json"))
    assert [(entry["uid"], entry["version"]) for entry in found] == [("cup.blue", 2)]
    assert await rce(platform, "query", "ASK { ?s a ?c }") == "yes\n"
    assert await rce(platform, "get", "object", "cup.blue", "--version", "1") == CUP
    await rce(platform, "remove", "object", "cup.blue")


async def test_killed_service_comes_back_with_all_that_it_acknowledged(platform: RealPlatform) -> None:
    client = KnowledgeClient(platform.url, user=USER, password=USER)
    await asyncio.to_thread(client.add, new_entry(cls="bed", id="one", owl=BED))
    process = platform.pid(SERVICE)
    platform.kill(process)

    async def back() -> bool:
        try:
            return await asyncio.to_thread(client.owl, "object", "bed.one") == BED
        except RceError:
            return False

    async with asyncio.timeout(TIMEOUT):
        while not await back():  # noqa: ASYNC110  # it is another process
            await asyncio.sleep(0.2)
    assert platform.pid(SERVICE) != process
    await asyncio.to_thread(client.remove, "object", "bed.one")


async def test_strangers_and_broken_texts_are_refused(platform: RealPlatform) -> None:
    with pytest.raises(Unauthorized):
        await asyncio.to_thread(KnowledgeClient(platform.url, user=USER, password="wrong").usage)
    client = KnowledgeClient(platform.url, user=USER, password=USER)
    with pytest.raises(InvalidRequest, match="line 2, column"):
        await asyncio.to_thread(client.add, new_entry(cls="a", id="b", owl="<rdf:RDF xmlns:rdf='a'>\n</a>"))


async def test_page_shows_entries_with_their_texts_and_versions(platform: RealPlatform, tmp_path: Path) -> None:
    client = KnowledgeClient(platform.url, user=USER, password=USER)
    picture = tmp_path / "map.png"
    cv2.imwrite(str(picture), np.full((40, 60), 128, np.uint8))
    await asyncio.to_thread(client.add, new_entry(kind="environment", cls="room", id="one", description="a room"))
    await asyncio.to_thread(client.change, "environment", "room.one", EntryChange(owl=BED))
    await asyncio.to_thread(client.put_file, "environment", "room.one", picture)
    async with chromium() as browser, open_page(browser) as (page, errors):
        await sign_in(page, platform.url, USER, USER)
        await visit(page, platform.url + "ui/#/knowledge")
        await page.get_by_label("Words").fill("room")
        await page.get_by_role("button", name="Search").click()
        await page.get_by_role("link", name="room.one").click()
        text = page.get_by_label("OWL text")
        await page.wait_for_function("() => document.querySelector('pre')?.textContent.includes('bed1')")
        assert await text.text_content() == BED
        await page.get_by_role("button", name="Read version 1").click()
        await page.wait_for_function("() => document.querySelector('pre')?.textContent.includes('cup1')")
        await page.get_by_role("button", name="Show map.png").first.click()
        await page.wait_for_function("() => document.querySelector('canvas.picture')?.width === 60")
        await screenshot(page, "knowledge")
        assert errors == []
    await asyncio.to_thread(client.remove, "environment", "room.one")
