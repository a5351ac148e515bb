"""Benchmark of lists and of the dashboard on a platform with many robots.

The browser is the Chromium of the system, controlled by Playwright. Lists are commands of `rce`, each a process of its
own on a terminal, as a user starts them.
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
TIMEOUT = 60_000  # milliseconds; of an action in the browser
SETTLE = 5.0  # seconds until a page has finished its start
PERCENT, MILLI = 100, 1e3


class List(Struct):
    """Seconds of one command, one value a sample.

    Attributes:
        wall: Elapsed time.
        cpu: CPU time.
    """

    wall: list[float]
    cpu: list[float]


class Result(Struct):
    """Results of one run; shares of the processor are of one core.

    Attributes:
        robots: Number of robots.
        interfaces: Number of interfaces.
        loads: Seconds from a reload until the graph is visible.
        browser: Share of the browser while the dashboard is open.
        master: Share of the Master while the dashboard is open.
        quiet: Share of the Master without a dashboard.
        lists: Times of each list.
    """

    robots: int
    interfaces: int
    loads: list[float]
    browser: float
    master: float
    quiet: float
    lists: dict[str, List]


def browser() -> str:
    """Return the path of Chromium.

    Raises:
        NotFound: It is not installed.
    """
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise NotFound(f"rce bench: no browser is installed: install one of {', '.join(BROWSERS)}")
    return program


async def measure(reactor: ReactorBase, program: str, size: Size, seconds: float, samples: int, log: IO[str]) -> Result:
    """Run the benchmark.

    Args:
        reactor: Twisted's reactor.
        program: Path of the browser.
        size: Size of the crowd.
        seconds: Time over which shares of a core are measured.
        samples: Number of loads and of lists.
        log: File for the logs of the programs.

    Raises:
        StartFailed: A program did not start, or a list failed.
    """
    with tempfile.TemporaryDirectory(prefix="rce-") as name:
        async with crowd(reactor, Path(name), size, log) as crowded:
            lists = {" ".join(words): await _list(crowded, words, samples) for words in LISTS}
            quiet = await _share([psutil.Process(crowded.pid)], seconds)
            async with _signed_in(program, crowded.url) as page:
                loads = [await _load(page, size) for _ in range(samples)]
                await asyncio.sleep(SETTLE)
                share, master = await asyncio.gather(
                    _share(_browsers(), seconds), _share([psutil.Process(crowded.pid)], seconds)
                )
    return Result(size.robots, size.interfaces, loads, share, master, quiet, lists)


async def _list(crowded: Crowded, words: Iterable[str], samples: int) -> List:
    """Measure one command."""
    command = [sys.executable, "-P", "-m", "rce.cli", *words, "--url", crowded.url]
    environment = os.environ | {"RCE_KEY": crowded.key}
    taken = List([], [])
    for _ in range(samples):
        began, before = time.monotonic(), _children_cpu()
        await asyncio.to_thread(_run_on_terminal, command, environment)
        taken.wall.append(time.monotonic() - began)
        taken.cpu.append(_children_cpu() - before)
    return taken


def _run_on_terminal(command: list[str], environment: Mapping[str, str]) -> None:
    """Run a command on a pseudo-terminal.

    Raises:
        StartFailed: The command failed.
    """
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, TERMINAL)
    output = b""
    with subprocess.Popen(command, env=environment, stdin=theirs, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        with contextlib.suppress(OSError):  # a terminal that no process has open any more raises EIO
            while read := os.read(ours, 65536):
                output += read
    os.close(ours)
    if process.returncode:
        raise StartFailed(f"{' '.join(command)}: {output.decode(errors='replace').strip()}")


def _children_cpu() -> float:
    """Return the CPU seconds of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@asynccontextmanager
async def _signed_in(program: str, url: str) -> AsyncIterator[Page]:
    """Open the dashboard in a browser and sign in."""
    async with async_playwright() as playwright:
        options = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = await playwright.chromium.launch(executable_path=program, args=options)
        try:
            page = await browser.new_page()
            page.set_default_timeout(TIMEOUT)
            await page.goto(f"{url}ui/")  # which reloads itself if a file does not arrive
            await page.get_by_label("User").fill(USER)
            await page.get_by_label("Password").fill(USER)
            await page.get_by_role("button", name="Sign in").click()
            await page.get_by_role("heading", name="Robots and environments").wait_for()
            yield page
        finally:
            await browser.close()


async def _load(page: Page, size: Size) -> float:
    """Reload the dashboard; return the seconds until the whole graph is visible."""
    began = time.monotonic()
    await page.reload()
    await page.get_by_text(f"{size.robots} environments, {size.interfaces} interfaces").wait_for()
    return time.monotonic() - began


def _browsers() -> list[psutil.Process]:
    """Return the processes of the browser that this process has started."""
    return [each for each in psutil.Process().children(recursive=True) if "chrom" in each.name()]


async def _share(processes: list[psutil.Process], seconds: float) -> float:
    """Return the share of one core that processes use within the next seconds."""
    began, before = time.monotonic(), _spent(processes)
    await asyncio.sleep(seconds)
    return (_spent(processes) - before) / (time.monotonic() - began)


def _spent(processes: list[psutil.Process]) -> float:
    """Return the CPU seconds that processes have used."""
    return sum(sum(each.cpu_times()[:2]) for each in processes if each.is_running())


def as_data(result: Result) -> dict[str, Any]:
    """Return all samples, in seconds, for JSON."""
    return {"machine": machine(), "dashboard": to_builtins(result)}


def as_text(result: Result) -> str:
    """Return a table of medians."""
    host = machine()
    title = (
        f"{result.robots} robots, {result.robots} environments, {result.interfaces} interfaces; "
        f"{host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
    )
    rows = [
        ["graph of the dashboard after a reload", f"{statistics.median(result.loads):.2f} s", ""],
        ["with the dashboard open: browser", f"{PERCENT * result.browser:.1f} %", "of a core"],
        ["Master", f"{PERCENT * result.master:.1f} %", ""],
        ["without a dashboard: Master", f"{PERCENT * result.quiet:.1f} %", ""],
    ]
    for name, taken in result.lists.items():
        wall, cpu = (f"{MILLI * statistics.median(each):.0f} ms" for each in (taken.wall, taken.cpu))
        rows.append([f"rce {name}", wall, f"{cpu} CPU"])
    return "\n".join([title, "", *aligned(rows)])
