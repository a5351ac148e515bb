"""Services of rosapi."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from endpoints.gateways.rosbridge.rosapi import Rosapi
from rce.control.calls.watching import RosAction, RosGraph, RosName, RosNode
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from tests.support.endpoints.fake_guest import FakeGuest

GRAPH = RosGraph(
    [RosName("/chat", ["std_msgs/msg/String"]), RosName("/odd", ["odd_msgs/msg/Odd"])],
    [RosName("/set", ["std_srvs/srv/SetBool"])],
    [RosAction("/f", ["demo/action/F"], ["/n"])],
    [RosNode("/n", ["/chat"], ["/odd"], ["/set"])],
)

WITH_PARAMETERS = RosGraph([], [RosName(f"/n/{each}_parameters", []) for each in ("get", "set", "list")])


async def ask(service: str, type: str, args: bytes) -> bytes:
    assert type == "rcl_interfaces/GetParameters"
    return b'{"values":[{"type":2,"integer_value":5}]}' if b"rate" in args else b'{"values":[{"type":0}]}'


async def call(name: str, args: Any = None) -> Any:
    rosapi = Rosapi(FakeGuest(WITH_PARAMETERS if name.endswith("_param") else GRAPH).as_guest())
    rosapi._parameters._ask = ask  # type: ignore[assignment]
    assert rosapi.has(f"/rosapi/{name}")
    return await rosapi.call(f"/rosapi/{name}", msgspec.json.encode(args or {}))


@pytest.mark.parametrize(
    ("name", "args", "answer"),
    [
        ("topics", {}, {"topics": ["/chat", "/odd"], "types": ["std_msgs/msg/String", "odd_msgs/msg/Odd"]}),
        ("topics_for_type", {"type": "std_msgs/String"}, {"topics": ["/chat"]}),
        ("services", {}, {"services": ["/set"]}),
        ("services_for_type", {"type": "std_srvs/SetBool"}, {"services": ["/set"]}),
        ("nodes", {}, {"nodes": ["/n"]}),
        ("node_details", {"node": "/n"}, {"subscribing": ["/odd"], "publishing": ["/chat"], "services": ["/set"]}),
        ("action_servers", {}, {"action_servers": ["/f"]}),
        ("topic_type", {"topic": "chat"}, {"type": "std_msgs/msg/String"}),
        ("topic_type", ["/chat"], {"type": "std_msgs/msg/String"}),
        ("topic_type", {"topic": "/none"}, {"type": ""}),
        ("service_type", {"service": "/set"}, {"type": "std_srvs/srv/SetBool"}),
        ("action_type", {"action": "/f"}, {"type": "demo/action/F"}),
        ("publishers", {"topic": "/chat"}, {"publishers": ["/n"]}),
        ("subscribers", {"topic": "/odd"}, {"subscribers": ["/n"]}),
        ("service_providers", {"service": "/set"}, {"providers": ["/n"]}),
        ("service_node", {"service": "/set"}, {"node": "/n"}),
        ("get_param", {"name": "/n:rate"}, {"value": "5", "successful": True, "reason": ""}),
        ("has_param", {"name": "/n:rate"}, {"exists": True}),
        ("has_param", {"name": "/n:size"}, {"exists": False}),
    ],
)
async def test_answers(name: str, args: Any, answer: Any) -> None:
    assert await call(name, args) == answer


async def test_raw_types_are_definitions_and_empty_for_unknown_types() -> None:
    answer = await call("topics_and_raw_types")
    assert answer["typedefs_full_text"] == ["string data\n", ""]


async def test_details_of_services_are_those_of_their_parts() -> None:
    answer = await call("service_response_details", {"type": "std_srvs/SetBool"})
    assert answer["typedefs"][0]["fieldnames"] == ["success", "message"]


async def test_parameter_that_is_not_set_has_the_default() -> None:
    answer = await call("get_param", {"name": "/n:size", "default_value": "3"})
    assert (answer["value"], answer["successful"]) == ("3", False)
    assert "not set" in answer["reason"]


@pytest.mark.parametrize(("default", "value"), [("", '""'), ("none", '"none"'), ("[1]", "[1]"), (None, "null")])
async def test_default_of_a_parameter_is_sent_as_json(default: Any, value: str) -> None:
    answer = await call("get_param", {"name": "/n:size", "default_value": default})
    assert answer["value"] == value


async def test_parameter_is_read_after_it_was_set() -> None:
    order: list[str] = []
    answered = asyncio.Event()

    async def slow(service: str, type: str, args: bytes) -> bytes:
        order.append(service)
        if type == "rcl_interfaces/GetParameters":
            return await ask(service, type, args)
        await answered.wait()
        order.append("set")
        return b'{"results":[{"successful":true,"reason":""}]}'

    rosapi = Rosapi(FakeGuest(WITH_PARAMETERS).as_guest())
    rosapi._parameters._ask = slow  # type: ignore[assignment]
    setting = asyncio.create_task(rosapi.call("/rosapi/set_param", b'{"name":"/n:rate","value":"5"}'))
    await asyncio.sleep(0)
    reading = [
        asyncio.create_task(rosapi.call(f"/rosapi/{each}_param", b'{"name":"/n:rate"}')) for each in ("get", "has")
    ]
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    answered.set()
    await asyncio.wait_for(asyncio.gather(setting, *reading), 1)
    assert order == ["/n/set_parameters", "set", "/n/get_parameters", "/n/get_parameters"]


async def test_time_and_version() -> None:
    assert (await call("get_time"))["time"]["sec"] > 1_700_000_000
    assert (await call("get_ros_version"))["version"] == 2


async def test_unknown_services_and_bad_arguments_are_refused() -> None:
    with pytest.raises(NotFound, match="no service dance"):
        await call("dance")
    with pytest.raises(InvalidRequest, match="topic must be a string"):
        await call("topic_type", {"topic": 5})


@pytest.mark.parametrize("args", [b'{"topic":"\xff"}', b"[" * 5000 + b"]" * 5000], ids=["not UTF-8", "deep"])
async def test_malformed_arguments_are_refused(args: bytes) -> None:
    with pytest.raises(InvalidRequest):
        await Rosapi(FakeGuest(GRAPH).as_guest()).call("/rosapi/topic_type", args)


@pytest.mark.parametrize("args", [{"value": [0] * 10_002}, {"name": "n", "value": str([0] * 10_002)}])
async def test_arguments_with_too_many_values_are_refused(args: Any) -> None:
    with pytest.raises(LimitExceeded, match="more than 10000 values"):
        await call("set_param", args)


async def test_topic_with_a_type_that_nobody_can_parse_is_passed_over() -> None:
    graph = RosGraph([RosName("/old", ["a type", "std_msgs/msg/String"]), RosName("/bad", ["?"])], [])
    answer = await Rosapi(FakeGuest(graph).as_guest()).call("/rosapi/topics_for_type", b'{"type":"std_msgs/String"}')
    assert answer == {"topics": ["/old"]}
