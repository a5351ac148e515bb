"""The live feed: a snapshot, then what changed, to each watcher what they may see; slow ones get a new snapshot."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from certified import certify
from served import Served, serve
from twisted.internet.base import ReactorBase
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from rce import messages as m
from rce.certificates import Authority
from rce.roles import Scopes
from rce.tls import CA, CERTIFICATE, KEY
from rce.views import Rate, Usage


class Watch:
    """A watcher's picture of the platform."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.seen: dict[str, dict[str, Any]] = {}
        self.messages = 0

    async def take(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(await asyncio.wait_for(self.socket.recv(), 20))
        self.messages += 1
        assert message["seq"] == self.messages
        if message.get("snapshot"):
            self.seen = {}
        for kind, views in message.get("put", {}).items():
            self.seen.setdefault(kind, {}).update(views)
        for kind, keys in message.get("drop", {}).items():
            for key in keys:
                del self.seen[kind][key]
        return message

    async def until(self, *path: str, value: Any) -> None:
        def now() -> Any:
            found: Any = self.seen
            for part in path:
                found = found.get(part, {})
            return found

        while now() != value:
            await self.take()


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path) as served:
        await served.robot("ann", "r1")
        yield served


async def watch(served: Served, by: str, **greeting: Any) -> Watch:
    secret, _ = await served.master.users.keys.add(by, "operator" if by == "olga" else "user")
    socket = await connect(f"ws://127.0.0.1:{served.port}/api/v1/live")
    await socket.send(json.dumps({"key": secret} | greeting))
    watcher = Watch(socket)
    assert (await watcher.take())["snapshot"]
    return watcher


async def test_a_watcher_sees_the_graph_change(served: Served) -> None:
    watcher = await watch(served, "ann")
    assert watcher.seen == {"robots": {"ann/r1": (await served.ask("GET", "/robots/r1")).body}}
    run = served.master.execute
    await run("ann", m.CreateContainer("brain", m.ContainerData(group="team")))
    await watcher.until("environments", "ann/brain", "state", value="ready")
    assert list(watcher.seen["groups"]) == ["ann/team"]
    await run("ann", m.AddNode("brain", "n", "demo", "talker"))
    await watcher.until("nodes", "ann/brain/n", "state", value="running")
    await run("ann", m.SetParameter("brain", "a/b", 1))
    await run("ann", m.AddInterface("brain", "out", "SubscriberInterface", "std_msgs/String"))
    await run("ann", m.AddInterface("r1", "in", "PublisherConverter", "std_msgs/String"))
    await run("ann", m.Connect("brain/out", "r1/in"))
    await watcher.until("connections", "ann/brain/out ann/r1/in", "state", value="up")
    await watcher.until("interfaces", "ann/r1/in", "connections", value=1)
    assert watcher.seen["robots"]["ann/r1"]["interfaces"] == 1
    assert watcher.seen["environments"]["ann/brain"] == (await served.ask("GET", "/environments/brain")).body
    await run("ann", m.DestroyContainer("brain"))
    await watcher.until("environments", value={})
    await watcher.until("interfaces", "ann/r1/in", "connections", value=0)
    assert not any(watcher.seen[kind] for kind in ("nodes", "parameters", "connections", "groups"))
    await watcher.socket.close()
    await until(lambda: not served.master.feed.watched)
    assert not served.master.feed.sight.views


async def test_machines_and_robots_come_and_go(served: Served) -> None:
    watcher = await watch(served, "olga", user="*")
    assert sorted(watcher.seen["machines"]) == ["m1", "west"]
    served.peers["west"].close()
    await watcher.until("machines", "west", "state", value="away")
    await watcher.until("robots", "ann/r1", "state", value="away")
    await watcher.socket.close()


async def test_each_sees_their_own(served: Served) -> None:
    watchers = [await watch(served, "bob", user="*"), await watch(served, "bob")]
    alls, robots = await watch(served, "olga", user="*"), await watch(served, "olga", user="ann", kinds=["robots"])
    await served.master.execute("ann", m.CreateContainer("brain"))
    await served.master.execute("bob", m.CreateContainer("other"))
    for watcher in watchers:
        await watcher.until("environments", "bob/other", "state", value="ready")
        assert list(watcher.seen) == ["environments"]
        assert list(watcher.seen["environments"]) == ["bob/other"]
    await alls.until("environments", "bob/other", "state", value="ready")
    assert sorted(alls.seen["environments"]) == ["ann/brain", "bob/other"]
    assert list(robots.seen) == ["robots"]
    for watcher in (*watchers, alls, robots):
        await watcher.socket.close()


async def test_what_is_measured_is_shown(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gauges measure while somebody watches, and say of what they have new figures."""

    async def measure() -> dict[str, set[str]]:
        return {}

    await served.master.execute("ann", m.CreateContainer("brain"))
    await served.master.execute("ann", m.AddInterface("r1", "in", "PublisherConverter", "std_msgs/String"))
    gauges = served.master.gauges
    monkeypatch.setattr(gauges, "measure", measure)
    watcher = await watch(served, "ann")
    (changed,) = gauges._watchers
    served.master.shown.rates = {"ann/r1/in": Rate(2.5, 100.0, 3)}
    served.master.shown.usage = {"ann/brain": Usage(0.5, 1000)}
    changed({"interfaces": {"ann/r1/in"}, "environments": {"ann/brain"}})
    await watcher.until("interfaces", "ann/r1/in", "rate", value={"messages": 2.5, "bytes": 100.0, "drops": 3})
    await watcher.until("environments", "ann/brain", "usage", value={"cores": 0.5, "memory": 1000})
    await watcher.socket.close()
    await until(lambda: not served.master.feed.watched)
    assert not gauges._watchers


async def test_one_who_does_not_read_gets_a_snapshot_later(served: Served) -> None:
    await served.master.execute("ann", m.CreateContainer("brain"))
    watcher = await watch(served, "ann")
    watcher.socket.transport.pause_reading()
    feed = served.master.feed
    for number in range(1000):
        await served.master.execute("ann", m.SetParameter("brain", "p", f"{number}" + 500_000 * "x"))
        if feed._behind:
            break
        await asyncio.sleep(0.1)
    assert feed._behind
    await served.master.execute("ann", m.SetParameter("brain", "p", "last"))
    watcher.socket.transport.resume_reading()
    await watcher.until("parameters", "ann/brain/:p", "value", value="last")
    assert not feed._behind
    await watcher.socket.close()


@pytest.mark.parametrize(
    ("greeting", "code"),
    [
        (b'{"key": "rce_wrong"}', 4401),
        (b'{"key": "secret"}', 4401),
        (b"{", 4400),
        (b'{"key": "rce_x", "more": 1}', 4400),
        (b'{"key": "rce_x", "kinds": ["users"]}', 4400),
    ],
)
async def test_who_may_not_watch(served: Served, greeting: bytes, code: int) -> None:
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        await socket.send(greeting.decode())
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(socket.recv(), 20)
        assert socket.close_code == code


async def test_one_whose_key_is_revoked_watches_no_more(served: Served) -> None:
    watcher = await watch(served, "ann")
    (key,) = await served.master.users.keys.of("ann")
    await served.master.guard.revoke_key("ann", key.id)
    with pytest.raises(ConnectionClosed):
        await watcher.take()
    assert watcher.socket.close_code == 4401
    await until(lambda: not served.master.feed.watched)


async def test_a_tied_key_watches_what_it_is_tied_to(served: Served) -> None:
    await served.robot("ann", "r2")
    run = served.master.execute
    for tag in ("brain", "second"):
        await run("ann", m.CreateContainer(tag))
    scopes = Scopes(robot="r1", environments=["brain"])
    secret, _ = await served.master.users.keys.add("ann", "robot", scopes=scopes)
    socket = await connect(f"ws://127.0.0.1:{served.port}/api/v1/live")
    await socket.send(json.dumps({"key": secret}))
    watcher = Watch(socket)
    await watcher.take()
    assert watcher.seen.keys() == {"robots", "environments"}
    assert [*watcher.seen["robots"], *watcher.seen["environments"]] == ["ann/r1", "ann/brain"]
    await served.master.sessions.disconnect("ann/r2", "")
    await run("ann", m.DestroyContainer("second"))
    await run("ann", m.DestroyContainer("brain"))
    assert (await watcher.take())["drop"] == {"environments": ["ann/brain"]}
    await socket.close()


async def test_another_users_things_are_not_there_to_watch(served: Served) -> None:
    secret, _ = await served.master.users.keys.add("bob", "user")
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        await socket.send(json.dumps({"key": secret, "user": "ann"}))
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(socket.recv(), 20)
        assert socket.close_code == 4404


async def test_it_is_for_websockets(served: Served) -> None:
    answer = await served.ask("GET", "/live")
    assert (answer.status, answer.headers["upgrade"], answer.body["code"]) == (426, "websocket", "upgrade_required")


async def until(true: Any) -> None:
    async with asyncio.timeout(20):
        while not true():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def test_it_is_watched_over_tls_too(reactor: ReactorBase, tmp_path: Path) -> None:
    """There the connection that is taken over lies within another."""
    authority = Authority.make("tests")
    keys = certify(tmp_path / "tls", authority, ["localhost"])
    description = f"ssl:0:interface=127.0.0.1:privateKey={keys / KEY}:certKey={keys / CERTIFICATE}"
    async with serve(reactor, tmp_path, at=description) as served:
        secret, _ = await served.master.users.keys.add("ann", "user")
        trust = ssl.create_default_context(cafile=str(keys / CA))
        async with connect(f"wss://localhost:{served.port}/api/v1/live", ssl=trust) as socket:
            await socket.send(json.dumps({"key": secret}))
            watcher = Watch(socket)
            await watcher.take()
            await served.master.execute("ann", m.CreateContainer("brain"))
            await watcher.until("environments", "ann/brain", "state", value="ready")
        await until(lambda: not served.master.feed.watched)
