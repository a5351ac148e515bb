"""The bare WebSocket of the benchmark, with a real server."""

from __future__ import annotations

import asyncio
import http
import json

import pytest
from websockets.asyncio.server import Request, Response, ServerConnection, serve

from rce.bench.traffic.socket import BareRobot, connect
from rce.errors import InvalidRequest, Lost

SIZES = (1, 125, 126, 65_535, 65_536, 300_000)


async def test_messages_of_all_sizes_pass_in_both_directions() -> None:
    received: asyncio.Queue[bytes] = asyncio.Queue()

    async def echo(server: ServerConnection) -> None:
        assert server.request is not None
        assert server.request.path == "/?userID=ann"
        async for message in server:
            await server.send(message)

    async with serve(echo, "127.0.0.1", 0, max_size=None, compression=None) as server:
        port = server.sockets[0].getsockname()[1]
        bare = await connect(f"ws://127.0.0.1:{port}/", "userID=ann", received.put_nowait)
        for size in SIZES:
            bare.send(b"x" * size)
        assert [len(await asyncio.wait_for(received.get(), 60)) for _ in SIZES] == list(SIZES)
        bare.close()


async def test_ping_is_answered() -> None:
    answered: asyncio.Future[float] = asyncio.get_running_loop().create_future()

    async def ping(server: ServerConnection) -> None:
        answered.set_result(await asyncio.wait_for(await server.ping(b"still there?"), 60))

    async with serve(ping, "127.0.0.1", 0, compression=None) as server:
        port = server.sockets[0].getsockname()[1]
        bare = await connect(f"ws://127.0.0.1:{port}/", "", lambda text: None)
        assert await answered >= 0
        bare.close()


async def test_refused_robot_raises_the_reason() -> None:
    def refuse(server: ServerConnection, request: Request) -> Response:
        return server.respond(http.HTTPStatus.UNAUTHORIZED, "wrong key")

    async def never(server: ServerConnection) -> None:
        raise AssertionError

    async with serve(never, "127.0.0.1", 0, process_request=refuse) as server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(InvalidRequest, match=r"refused: HTTP/1\.1 401"):
            await connect(f"ws://127.0.0.1:{port}/", "", lambda text: None)


async def test_lost_connection_is_told() -> None:
    async def hang_up(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    server = await asyncio.start_server(hang_up, "127.0.0.1", 0)
    async with server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(Lost):
            await connect(f"ws://127.0.0.1:{port}/", "", lambda text: None)


async def test_command_is_answered_or_refused() -> None:
    async def answer(server: ServerConnection) -> None:
        async for message in server:
            kind = json.loads(message)["type"]
            await server.send('{"type":"DM","data":{}}')  # a message is no answer
            error = '{"type":"ER","data":"no such robot"}'
            await server.send('{"type":"ST","data":{"topic":"ack","id":1}}' if kind == "CN" else error)

    async with serve(answer, "127.0.0.1", 0) as server:
        robot = BareRobot("r1")
        robot.socket = await connect(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}/", "", robot.received)
        await robot.command("CN", {"addInterfaces": []})
        with pytest.raises(InvalidRequest, match=r"r1: .*no such robot"):
            await robot.command("CX", {"connect": []})
        robot.socket.close()
