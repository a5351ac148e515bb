"""HTTP requests: robots' entry and API of the Master, handshake of the Robot endpoint, map and knowledge service."""

from __future__ import annotations

import asyncio

import pytest

from tests.support.endpoints.raw_robot import WEBSOCKET_HEADERS
from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.sockets import RawConnection
from tests.support.fuzz.target import Target, port_of

pytestmark = pytest.mark.slow

AT_ONCE = 20
JSON = "Content-Type: application/json\r\nAuthorization: Basic YWRtaW46d3Jvbmc=\r\n"
TUS = "Tus-Resumable: 1.0.0\r\nUpload-Length: 10\r\nUpload-Metadata: filename YS5sb2c=\r\nUpload-Offset: 0\r\n"
REQUESTS = {
    "robot": (
        f"GET /?userID=stranger&robotID=r&password=abc&features=ack,events HTTP/1.1\r\n{WEBSOCKET_HEADERS}\r\n",
        f"GET /?userID=a&robotID=b&key=rce_abc&owner=c&resume=x&refuse=close HTTP/1.1\r\n{WEBSOCKET_HEADERS}\r\n",
        f"GET /?compress=deflate HTTP/1.1\r\n{WEBSOCKET_HEADERS}Sec-WebSocket-Extensions: permessage-deflate\r\n\r\n",
    ),
    "master": (
        "GET /?userID=stranger&version=20130902 HTTP/1.1\r\nHost: x\r\n\r\n",
        "GET /api/v1/environments?limit=5&after=%2Fa HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer rce_x\r\n\r\n",
        f'POST /api/v1/keys HTTP/1.1\r\nHost: x\r\n{JSON}Content-Length: 15\r\n\r\n{{"role":"admin"}}',
        f"POST /api/v1/commands HTTP/1.1\r\nHost: x\r\n{JSON}Transfer-Encoding: chunked\r\n\r\n2\r\n{{}}\r\n0\r\n\r\n",
        "GET /ui/index.html HTTP/1.1\r\nHost: x\r\nRange: bytes=0-5\r\nIf-None-Match: *\r\nCookie: a=b\r\n\r\n",
        f"GET /api/v1/live HTTP/1.1\r\n{WEBSOCKET_HEADERS}\r\n",
    ),
    "maps": (
        "GET /map-service/v1/jobs HTTP/1.1\r\nHost: x\r\nAuthorization: Basic c3RyYW5nZXI6eA==\r\n\r\n",
        f"POST /map-service/v1/uploads HTTP/1.1\r\nHost: x\r\n{TUS}Content-Length: 0\r\n\r\n",
        f"PATCH /map-service/v1/uploads/abc HTTP/1.1\r\nHost: x\r\n{TUS}Content-Length: 2\r\n\r\nab",
        "POST /map-service/soap HTTP/1.1\r\nHost: x\r\nContent-Type: text/xml\r\nContent-Length: 4\r\n\r\n<a/>",
    ),
    "knowledge": (
        "GET /knowledge-service/entries?kind=object&class=Cup HTTP/1.1\r\nHost: x\r\n\r\n",
        "GET /knowledge-service/entries/object/cup.blue/files/a?version=1 HTTP/1.1\r\nHost: x\r\n\r\n",
        f'POST /knowledge-service/query HTTP/1.1\r\nHost: x\r\n{JSON}Content-Length: 13\r\n\r\n{{"query":"A"}}',
        "PUT /api/0.1/object/cup.blue/rce_x/5 HTTP/1.1\r\nHost: x\r\nContent-Length: 0\r\n\r\n",
    ),
}


@pytest.mark.share(0.03)
@pytest.mark.parametrize("port", REQUESTS)
async def test_each_request_is_answered_or_closed(target: Target, cases: int, seed: str, port: str) -> None:
    mutator = Mutator(f"{seed} http {port}")
    number = _port(target, port)
    for start in range(0, cases, AT_ONCE):
        requests = [mutator.damage(mutator.choose(REQUESTS[port]).encode()) for _ in range(min(AT_ONCE, cases - start))]
        answers = await asyncio.gather(*(_ask(number, mutator.pieces(each, 3)) for each in requests))
        for request, answer in zip(requests, answers, strict=True):
            assert not answer or answer.startswith(b"HTTP/"), (request, answer)
            assert not answer.startswith((b"HTTP/1.1 500", b"HTTP/1.0 500")) or b"/soap" in request, (request, answer)
    await target.check(f"HTTP, {port}")


async def _ask(port: int, pieces: list[bytes]) -> bytes:
    connection = await RawConnection.open(port)
    for piece in pieces:
        await connection.send(piece)
    return await connection.until_closed()


def _port(target: Target, name: str) -> int:
    urls = {"master": target.processes.url, "maps": target.maps, "knowledge": target.knowledge}
    return port_of(urls.get(name, f":{target.processes.port}"))
