"""The dashboard with 200 robots, 200 environments and 2,000 interfaces: `python tests/master/trial_dashboard.py`.

A real Master and a real Chromium; the processes around the Master are in memory here; what they count always differs.
Prints how long the page takes to show the graph, and what of a core page and Master take while it is looked at.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
from trial_capacity import Around, all_of, master, used
from twisted.internet.base import ReactorBase

from master.store import Store
from master.users import Users
from rce import loop
from rce import messages as m
from rce.calls.call import Nothing
from rce.calls.endpoints import AddRoute, Bind
from rce.calls.robots import Execute, Login
from rce.calls.watching import Counts, CountTraffic, InterfaceTraffic, MeasureUsage, Traffic, Usage, Used
from rce.control import Control, Handlers

sys.path.append(str(Path(__file__).parents[1] / "e2e"))
from chromium import chromium, opened, sign_in

USER, PASSWORD = "ann", "correct horse battery staple"
PAIRS, EACH = 200, 5  # robots with an environment each; interfaces of each of the two
CONNECTED = 4  # of them
WATCHED = 20.0  # seconds


class Busy(Around):
    """All interfaces carry messages, all environments work."""

    def __init__(self, reactor: ReactorBase, address: str) -> None:
        super().__init__(reactor, address)
        self._bound: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))  # peers by id by process
        self._began = time.monotonic()

    def handlers(self, name: str) -> Handlers:
        handlers = super().handlers(name)
        bound = self._bound[name]

        async def bind(call: Bind) -> Nothing:
            bound[call.interface.id] = set()
            return Nothing()

        async def route(call: AddRoute) -> Nothing:
            bound[call.route.interface].add(call.route.peer)
            return Nothing()

        async def count(call: CountTraffic) -> Traffic:
            now = time.monotonic() - self._began
            each = Counts(int(now * now), int(1000 * now * now))
            return Traffic(
                {key: InterfaceTraffic(each, each, dict.fromkeys(peers, each)) for key, peers in bound.items()}
            )

        async def measure(call: MeasureUsage) -> Usage:
            now = time.monotonic() - self._began
            return Usage({key: Used(now * now / 1000, int(1e8 + 1e6 * now)) for key in self.environments})

        handlers.on(Bind, bind)
        handlers.on(AddRoute, route)
        handlers.on(CountTraffic, count)
        handlers.on(MeasureUsage, measure)
        return handlers


async def fill(robots: Control, key: str) -> None:
    def execute(number: int, command: m.Command) -> Callable[[], Any]:
        return lambda: robots.call(Execute.of(f"{USER}/robot{number}", command))

    def interface(number: int, owner: str, kind: str, tag: int) -> Callable[[], Any]:
        return execute(number, m.AddInterface(f"{owner}{number}", f"i{tag}", kind, "std_msgs/String", f"/t{tag}"))

    numbers = range(PAIRS)
    await all_of((lambda n=n: robots.call(Login(USER, f"robot{n}", key))) for n in numbers)  # type: ignore[misc]
    await all_of(execute(n, m.CreateContainer(f"brain{n}")) for n in numbers)
    sides = [("robot", "SubscriberConverter"), ("brain", "PublisherInterface")]
    await all_of(interface(n, *side, tag) for n in numbers for side in sides for tag in range(EACH))
    await all_of(
        execute(n, m.Connect(f"robot{n}/i{tag}", f"brain{n}/i{tag}")) for n in numbers for tag in range(CONNECTED)
    )


def spent(processes: list[psutil.Process]) -> float:
    """Processor time in seconds."""
    return sum(sum(each.cpu_times()[:2]) for each in processes if each.is_running())


async def look(url: str, pid: int) -> None:
    async with chromium() as browser, opened(browser) as (page, _):
        await sign_in(page, url, USER, PASSWORD)
        began = time.monotonic()
        await page.reload()
        await page.get_by_text(f"{PAIRS} environments, {2 * PAIRS * EACH} interfaces").wait_for()
        print(f"the graph is there after {time.monotonic() - began:.2f} s")
        await asyncio.sleep(5)
        children = [each for each in psutil.Process().children(recursive=True) if "chrom" in each.name()]
        before, ours = spent(children), used(pid)[1]
        await asyncio.sleep(WATCHED)
        print(f"browser: {100 * (spent(children) - before) / WATCHED:.1f} % of a core (all of its processes)")
        print(f"Master: {100 * (used(pid)[1] - ours) / WATCHED:.1f} % of a core")
    await asyncio.sleep(3)
    ours = used(pid)[1]
    await asyncio.sleep(WATCHED)
    print(f"Master while nobody looks: {100 * (used(pid)[1] - ours) / WATCHED:.1f} % of a core")


async def trial(reactor: ReactorBase) -> None:
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        store = Store(f"sqlite:///{directory / 'master.db'}")
        await store.open()
        users = Users(store)
        await users.add(USER, PASSWORD)
        key, _ = await users.add_key(USER)
        await store.close()
        async with master(directory, "robot:west:t1,container:m1:t2") as (process, ready):
            around = Busy(reactor, ready.control)
            robots = await around.join("robot", "west", "t1", url="ws://:1/", addresses=["unix:/w"])
            await around.join("container", "m1", "t2", capacity=2 * PAIRS)
            await fill(robots, key)
            await look(ready.url, process.pid)


if __name__ == "__main__":
    sys.exit(loop.run(trial))
