"""How long lists take, and what the dashboard takes of browser and Master, at a platform with much in it.

The browser is the system's Chromium, by Playwright. Lists are those of the console, each a process of its own at a
terminal, as a user starts it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import IO, Any

import psutil
from msgspec import Struct, to_builtins
from playwright.async_api import Page, async_playwright
from twisted.internet.base import ReactorBase

from rce.bench.crowd import USER, Crowded, Size, crowd
from rce.bench.report import aligned, machine
from rce.errors import NotFound, StartFailed

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
LISTS = (("env", "list"), ("robot", "list"))
TERMINAL = (40, 120)  # rows and columns
TIMEOUT = 60_000  # milliseconds
SETTLE = 5.0  # seconds until what a page does at its start is over
PERCENT, MILLI = 100, 1e3


class List(Struct):
    """Seconds of one command: by the clock, and of a processor."""

    wall: list[float]
    cpu: list[float]


class Result(Struct):
    """`loads`: seconds from a reload until the graph is there. Shares are of one core, without a dashboard: `quiet`."""

    robots: int
    interfaces: int
    loads: list[float]
    browser: float
    master: float
    quiet: float
    lists: dict[str, List]


def browser() -> str:
    """The program of the system's Chromium. NotFound."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise NotFound(f"rce bench: no browser here: install one of {', '.join(BROWSERS)}")
    return program


async def measure(reactor: ReactorBase, program: str, size: Size, seconds: float, samples: int, log: IO[str]) -> Result:
    """Take `samples` loads and lists, and the shares of a core over `seconds`, with this browser. StartFailed."""
    with tempfile.TemporaryDirectory(prefix="rce-") as name:
        async with crowd(reactor, Path(name), size, log) as crowded:
            lists = {" ".join(words): await _list(crowded, words, samples) for words in LISTS}
            quiet = await _share([psutil.Process(crowded.pid)], seconds)
            async with _signed_in(program, crowded.url) as page:
                loads = [await _load(page, size) for _ in range(samples)]
                await asyncio.sleep(SETTLE)
                shown, master = await asyncio.gather(
                    _share(_browsers(), seconds), _share([psutil.Process(crowded.pid)], seconds)
                )
    return Result(size.robots, size.interfaces, loads, shown, master, quiet, lists)


async def _list(crowded: Crowded, words: Iterable[str], samples: int) -> List:
    command = [sys.executable, "-P", "-m", "rce.cli", *words, "--url", crowded.url]
    surroundings = os.environ | {"RCE_KEY": crowded.key}
    taken = List([], [])
    for _ in range(samples):
        began, before = time.monotonic(), _of_children()
        await asyncio.to_thread(_at_terminal, command, surroundings)
        taken.wall.append(time.monotonic() - began)
        taken.cpu.append(_of_children() - before)
    return taken


def _at_terminal(command: list[str], surroundings: Mapping[str, str]) -> None:
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, TERMINAL)
    said = b""
    with subprocess.Popen(command, env=surroundings, stdin=theirs, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        with contextlib.suppress(OSError):  # how a terminal says that nobody has it open any more
            while read := os.read(ours, 65536):
                said += read
    os.close(ours)
    if process.returncode:
        raise StartFailed(f"{' '.join(command)}: {said.decode(errors='replace').strip()}")


def _of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@asynccontextmanager
async def _signed_in(program: str, url: str) -> AsyncIterator[Page]:
    async with async_playwright() as playwright:
        options = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = await playwright.chromium.launch(executable_path=program, args=options)
        try:
            page = await browser.new_page()
            page.set_default_timeout(TIMEOUT)
            await page.goto(f"{url}ui/")
            await page.get_by_label("User").fill(USER)
            await page.get_by_label("Password").fill(USER)
            await page.get_by_role("button", name="Sign in").click()
            await page.get_by_role("heading", name="Robots and environments").wait_for()
            yield page
        finally:
            await browser.close()


async def _load(page: Page, size: Size) -> float:
    began = time.monotonic()
    await page.reload()
    await page.get_by_text(f"{size.robots} environments, {size.interfaces} interfaces").wait_for()
    return time.monotonic() - began


def _browsers() -> list[psutil.Process]:
    """All processes of the browser that this one has started."""
    return [each for each in psutil.Process().children(recursive=True) if "chrom" in each.name()]


async def _share(processes: list[psutil.Process], seconds: float) -> float:
    """Of one core, over so many seconds."""
    began, before = time.monotonic(), _spent(processes)
    await asyncio.sleep(seconds)
    return (_spent(processes) - before) / (time.monotonic() - began)


def _spent(processes: list[psutil.Process]) -> float:
    return sum(sum(each.cpu_times()[:2]) for each in processes if each.is_running())


def as_data(result: Result) -> dict[str, Any]:
    """Every sample, in seconds."""
    return {"machine": machine(), "dashboard": to_builtins(result)}


def as_text(result: Result) -> str:
    """Medians."""
    host = machine()
    title = (
        f"{result.robots} robots, {result.robots} environments, {result.interfaces} interfaces; "
        f"{host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
    )
    rows = [
        ["the dashboard's graph after a reload", f"{statistics.median(result.loads):.2f} s", ""],
        ["while it is looked at: browser", f"{PERCENT * result.browser:.1f} %", "of a core"],
        ["Master", f"{PERCENT * result.master:.1f} %", ""],
        ["while nobody looks: Master", f"{PERCENT * result.quiet:.1f} %", ""],
    ]
    for name, taken in result.lists.items():
        wall, cpu = (f"{MILLI * statistics.median(each):.0f} ms" for each in (taken.wall, taken.cpu))
        rows.append([f"rce {name}", wall, f"{cpu} of a processor"])
    return "\n".join([title, "", *aligned(rows)])
