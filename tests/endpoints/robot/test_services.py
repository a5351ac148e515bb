"""Services between robots."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from rce.net.budget import INTERFACE
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import USER, Robot


async def test_call_of_robot_that_does_not_read_is_refused_when_its_queue_has_too_many_bytes(
    platform: Platform,
) -> None:
    caller, server = await platform.robot("caller"), await platform.robot("server")
    await caller.add("ask", "ServiceProviderForwarder", "std_srvs/SetBool")
    await caller.add("serve", "ServiceClientForwarder", "std_srvs/SetBool", of="server")
    await caller.connect("caller/ask", "server/serve")
    await caller.receive()
    await server.receive()
    server.socket.transport.pause_reading()
    for number in range(INTERFACE // 1_000_000 + 10):
        name = f"{number:032x}"
        frame = {"iTag": "ask", "type": "std_srvs/SetBool", "msgID": name, "msg*": name}
        await caller.send({"type": "DM", "data": frame}, name.encode() + bytes(1_000_000))
    answer = await caller.receive()
    assert answer["type"] == "ER"
    assert "too many bytes wait for robot testUser/server" in answer["data"]


async def service(platform: Platform, features: str = "") -> tuple[Robot, Robot]:
    """Return a robot that calls a service by its interface `ask`, and one that answers at `serve`."""
    caller, server_ = await platform.robot("caller", features), await platform.robot("server", features)
    if features:
        await caller.receive()
        await server_.receive()
    await caller.add("ask", "ServiceProviderConverter", "std_srvs/SetBool")
    await caller.add("serve", "ServiceClientConverter", "std_srvs/SetBool", of="server")
    await caller.connect("caller/ask", "server/serve")
    await caller.receive()
    await server_.receive()
    return caller, server_


async def test_service_calls_between_robots(platform: Platform) -> None:
    caller, provider = await service(platform)
    kind = "std_srvs/SetBool"
    for number in range(5):
        await caller.data("ask", {"data": True}, kind, f"call{number}")
    requests = await provider.receive_all(5)
    assert len({request["data"]["msgID"] for request in requests}) == 5
    for number, request in reversed(list(enumerate(requests))):
        answer = {"success": True, "message": str(number)}
        await provider.data("serve", answer, kind, request["data"]["msgID"])
    answers = await caller.receive_all(5)
    assert {(each["data"]["msgID"], each["data"]["msg"]["message"]) for each in answers} == {
        (f"call{number}", str(number)) for number in range(5)
    }
    await provider.data("serve", {"success": True}, kind, requests[0]["data"]["msgID"])
    assert "no unanswered call" in (await provider.receive())["data"], "only the first answer counts"


async def too_late(provider: Robot, kind: str, name: str) -> Any:
    """Return the error about a response, which is given again until the provider's side has given up the call, too."""
    while True:
        await provider.data("serve", {"success": True}, kind, name)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                return await provider.receive()


async def failure(caller: Robot) -> tuple[str, str]:
    """Return the id of the next call that failed, and the code of its error."""
    answer = await caller.receive()
    assert answer["type"] == "ER", answer
    assert answer["error"]["fields"]["iTag"] == "ask"
    return answer["error"]["fields"]["msgID"], answer["error"]["code"]


async def test_service_call_without_an_answer_times_out(make_platform: Any) -> None:
    platform = await make_platform(service_timeout=0.2)
    caller, provider = await service(platform, "ack")
    kind = "std_srvs/SetBool"
    await caller.data("ask", {"data": True}, kind, "late")
    late = (await provider.receive())["data"]["msgID"]
    assert await failure(caller) == ("late", "timed_out")
    assert (await too_late(provider, kind, late))["error"]["code"] == "not_connected"


async def test_failed_service_calls_are_reported(platform: Platform) -> None:
    caller, provider = await service(platform, "ack")
    kind = "std_srvs/SetBool"

    await caller.data("ask", {"data": True}, kind, "refused")
    name = (await provider.receive())["data"]["msgID"]
    await provider.send({"type": "DM", "data": {"iTag": "serve", "type": kind, "msgID": name, "error": "no motor"}})
    assert (await failure(caller))[0] == "refused"

    await caller.data("ask", {"data": True}, kind, "wrong")
    name = (await provider.receive())["data"]["msgID"]
    await provider.data("serve", {"success": "perhaps"}, kind, name)
    assert await failure(caller) == ("wrong", "conversion")
    assert (await provider.receive())["error"]["code"] == "conversion"

    await caller.data("ask", {"data": True}, kind, "cut")
    await provider.receive()
    await provider.send({"type": "CX", "data": {"disconnect": [{"tagA": "caller/ask", "tagB": "server/serve"}]}})
    frames = await caller.receive_all(2)
    assert {frame["type"] for frame in frames} == {"ER", "ST"}


async def test_service_message_too_large_for_its_receiver_fails_the_call(platform: Platform) -> None:
    caller, provider = await service(platform, "ack")
    kind = "std_srvs/SetBool"
    sessions = platform.endpoint.sessions
    sessions[f"{USER}/server"].limit = 10
    await caller.data("ask", {"data": True}, kind, "request")
    answer = await caller.receive()
    assert (answer["error"]["code"], answer["error"]["fields"]["msgID"]) == ("limit_exceeded", "request")
    await provider.receive()
    sessions[f"{USER}/server"].limit, sessions[f"{USER}/caller"].limit = 1000, 10
    await caller.data("ask", {"data": True}, kind, "response")
    name = (await provider.receive())["data"]["msgID"]
    await provider.data("serve", {"success": True}, kind, name)
    answer = await caller.receive()
    assert (answer["error"]["code"], answer["error"]["fields"]["msgID"]) == ("limit_exceeded", "response")
