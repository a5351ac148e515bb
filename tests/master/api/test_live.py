"""Live feed: a snapshot, then changes that the watcher may see; slow watchers get a new snapshot."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import ssl
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from master.api import live
from rce.api.roles import Scopes
from rce.api.views import Rate, Usage
from rce.net.certificates import Authority
from rce.net.tls import CA, CERTIFICATE, KEY
from rce.protocol import messages as m
from tests.support.certificates import certify
from tests.support.master.served import Served, serve
from tests.support.master.watch import Watch, watch

HANDSHAKE = (
    b"GET /api/v1/live HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: MTIzNDU2Nzg5MDEyMzQ1Ng==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


@pytest.fixture
async def served(served: Served) -> Served:
    await served.robot("ann", "r1")
    return served


async def test_watcher_sees_the_graph_change(served: Served) -> None:
    watcher = await watch(served, "ann")
    assert watcher.seen == {"robots": {"ann/r1": (await served.ask("GET", "/robots/r1")).body}}
    run = served.master.commands.execute
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
    assert not served.master.feed.view_cache.views


async def test_machines_and_robots_that_disconnect_are_away(served: Served) -> None:
    watcher = await watch(served, "olga", user="*")
    assert sorted(watcher.seen["machines"]) == ["m1", "west"]
    served.peers["west"].close()
    await watcher.until("machines", "west", "state", value="away")
    await watcher.until("robots", "ann/r1", "state", value="away")
    await watcher.socket.close()


async def test_watchers_see_what_their_users_may_see(served: Served) -> None:
    watchers = [await watch(served, "bob", user="*"), await watch(served, "bob")]
    alls, robots = await watch(served, "olga", user="*"), await watch(served, "olga", user="ann", kinds=["robots"])
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    await served.master.commands.execute("bob", m.CreateContainer("other"))
    for watcher in watchers:
        await watcher.until("environments", "bob/other", "state", value="ready")
        assert list(watcher.seen) == ["environments"]
        assert list(watcher.seen["environments"]) == ["bob/other"]
    await alls.until("environments", "bob/other", "state", value="ready")
    assert sorted(alls.seen["environments"]) == ["ann/brain", "bob/other"]
    assert list(robots.seen) == ["robots"]
    for watcher in (*watchers, alls, robots):
        await watcher.socket.close()


async def test_measured_rates_and_usage_are_sent(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gauges measure while somebody watches, and report which figures have changed."""

    async def measure() -> dict[str, set[str]]:
        return {}

    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    await served.master.commands.execute("ann", m.AddInterface("r1", "in", "PublisherConverter", "std_msgs/String"))
    gauges = served.master.gauges
    monkeypatch.setattr(gauges, "measure", measure)
    watcher = await watch(served, "ann")
    (changed,) = gauges._watchers
    served.master.presenter.rates = {"ann/r1/in": Rate(2.5, 100.0, 3)}
    served.master.presenter.usage = {"ann/brain": Usage(0.5, 1000)}
    changed({"interfaces": {"ann/r1/in"}, "environments": {"ann/brain"}})
    await watcher.until(
        "interfaces", "ann/r1/in", "rate", value={"messages": 2.5, "bytes": 100.0, "drops": 3, "unheard": 0}
    )
    await watcher.until("environments", "ann/brain", "usage", value={"cores": 0.5, "memory": 1000})
    await watcher.socket.close()
    await until(lambda: not served.master.feed.watched)
    assert not gauges._watchers


async def test_slow_watcher_gets_a_snapshot_once_it_reads_again(served: Served) -> None:
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    watcher = await watch(served, "ann")
    watcher.socket.transport.pause_reading()
    feed = served.master.feed
    for number in range(1000):
        await served.master.commands.execute("ann", m.SetParameter("brain", "p", f"{number}" + 500_000 * "x"))
        if feed._behind:
            break
        await asyncio.sleep(0.1)
    assert feed._behind
    await served.master.commands.execute("ann", m.SetParameter("brain", "p", "last"))
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
async def test_wrong_greeting_closes_with_the_status_of_the_error(served: Served, greeting: bytes, code: int) -> None:
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        await socket.send(greeting.decode())
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(socket.recv(), 20)
        assert socket.close_code == code


async def test_revoked_key_closes_the_watcher(served: Served) -> None:
    watcher = await watch(served, "ann")
    (key,) = await served.master.users.keys.of("ann")
    await served.master.guard.revoke_key("ann", key.id)
    with pytest.raises(ConnectionClosed):
        await watcher.take()
    assert watcher.socket.close_code == 4401
    await until(lambda: not served.master.feed.watched)


async def test_restricted_key_watches_only_its_resources(served: Served) -> None:
    await served.robot("ann", "r2")
    run = served.master.commands.execute
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


async def test_other_users_resources_cannot_be_watched(served: Served) -> None:
    secret, _ = await served.master.users.keys.add("bob", "user")
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        await socket.send(json.dumps({"key": secret, "user": "ann"}))
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(socket.recv(), 20)
        assert socket.close_code == 4404


async def test_request_without_upgrade_is_refused(served: Served) -> None:
    answer = await served.ask("GET", "/live")
    assert (answer.status, answer.headers["upgrade"], answer.body["code"]) == (426, "websocket", "upgrade_required")


@pytest.mark.parametrize("header", ["Sec-WebSocket-Key: !", "Sec-WebSocket-Key: dGhlIé", "Sec-WebSocket-Version: 7"])
async def test_malformed_handshake_is_a_bad_request(served: Served, header: str) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", served.port)
    lines = ["GET /api/v1/live HTTP/1.1", "Host: x", "Upgrade: websocket", "Connection: Upgrade", header]
    writer.write(("\r\n".join(lines) + "\r\n\r\n").encode())
    assert (await asyncio.wait_for(reader.readline(), 20)).split()[1] == b"400"
    writer.close()


async def test_binary_greeting_and_further_messages_close_the_socket(served: Served) -> None:
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        await socket.send(b"{}")
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(socket.recv(), 20)
        assert socket.close_code == 1008
    watcher = await watch(served, "ann")
    await watcher.socket.send("more")
    await asyncio.wait_for(watcher.socket.wait_closed(), 20)
    assert watcher.socket.close_code == 1008
    await until(lambda: not served.master.feed.watched)


@pytest.mark.parametrize(("size", "code"), [(live.MAX_MESSAGE, 4400), (live.MAX_MESSAGE + 1, 1009)])
async def test_messages_are_limited(served: Served, size: int, code: int) -> None:
    """The largest message is read, and found not to be JSON."""
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        await socket.send("x" * size)
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(socket.recv(), 20)
        assert socket.close_code == code


async def test_socket_without_a_greeting_is_closed(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "GREETING_TIMEOUT", 0.05)
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        await asyncio.wait_for(socket.wait_closed(), 20)
        assert socket.close_code == 1008


async def test_watchers_of_a_user_are_limited(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "MAX_WATCHERS", 1)
    first = await watch(served, "ann")
    async with connect(f"ws://127.0.0.1:{served.port}/api/v1/live") as socket:
        secret, _ = await served.master.users.keys.add("ann", "user")
        await socket.send(json.dumps({"key": secret}))
        await asyncio.wait_for(socket.wait_closed(), 20)
        assert socket.close_code == 4413
    await first.socket.close()
    await until(lambda: not served.master.feed.watched)
    await (await watch(served, "ann")).socket.close()


@pytest.mark.slow
async def test_pings_are_not_read_from_a_client_that_does_not_read(served: Served) -> None:
    """The pongs would be kept in memory."""
    loop = asyncio.get_running_loop()
    with socket.create_connection(("127.0.0.1", served.port), 20) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall(HANDSHAKE)
        connection.setblocking(False)
        head = b""
        while b"\r\n\r\n" not in head:
            head += await asyncio.wait_for(loop.sock_recv(connection, 4096), 20)
        assert head.startswith(b"HTTP/1.1 101 ")
        pings = Frame(Opcode.PING, 100 * b"?").serialize(mask=True) * 1000
        with contextlib.suppress(TimeoutError):
            for _ in range(500):
                await asyncio.wait_for(loop.sock_sendall(connection, pings), 2)
            pytest.fail("the server reads pings without a bound")


async def until(true: Any) -> None:
    async with asyncio.timeout(20):
        while not true():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def test_live_feed_over_tls(reactor: ReactorBase, tmp_path: Path) -> None:
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
            await served.master.commands.execute("ann", m.CreateContainer("brain"))
            await watcher.until("environments", "ann/brain", "state", value="ready")
        await until(lambda: not served.master.feed.watched)
