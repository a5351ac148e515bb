"""ROS parameters by the services of their nodes."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from endpoints.gateways.parameters import Parameters
from rce.control.calls.watching import RosGraph, RosName, RosNode
from rce.errors import InvalidRequest, NotFound, RceError

VERBS = ("get", "set", "list")


class Node:
    """Node /camera, whose parameters are values of `rcl_interfaces/ParameterValue`."""

    def __init__(self) -> None:
        self.age = 100.0  # seconds since it has started
        self.values: dict[str, dict[str, Any]] = {"rate": {"type": 2, "integer_value": 5}}

    async def graph(self, age: float) -> RosGraph:
        serving = RosNode("/camera", serves=["/camera/list_parameters"])
        services = [RosName(f"/{node}/{each}_parameters", []) for node in ("camera", "dead", "odd") for each in VERBS]
        nodes = [serving, RosNode("/dead", serves=["/dead/list_parameters"]), RosNode("/plain")]
        return RosGraph([], services if age < self.age else [], [], nodes)

    async def ask(self, service: str, type: str, args: bytes) -> bytes:
        values = msgspec.json.decode(args)
        if service.startswith("/dead/"):
            raise RceError("no answer")
        answer: Any
        if type.endswith("ListParameters"):
            answer = {"result": {"names": list(self.values)}}
        elif type.endswith("GetParameters"):
            answer = {"values": [self.values.get(name, {"type": 0}) for name in values["names"]]}
        else:
            (change,) = values["parameters"]
            good = change["name"] != "fixed"
            self.values |= {change["name"]: change["value"]} if good else {}
            answer = {"results": [{"successful": good, "reason": "" if good else "it is fixed"}]}
        return msgspec.json.encode(answer)


@pytest.fixture
def node() -> Node:
    return Node()


@pytest.fixture
def parameters(node: Node) -> Parameters:
    return Parameters(node.graph, node.ask)


async def test_value_is_read(parameters: Parameters) -> None:
    assert await parameters.get("/camera:rate") == 5
    assert await parameters.get("camera:rate") == 5
    with pytest.raises(NotFound, match="not set"):
        await parameters.get("/camera:size")


@pytest.mark.parametrize("value", [True, 7, 1.5, "fast", [1, 2], [1.5], ["a"], [True]])
async def test_value_that_was_set_is_read_back(parameters: Parameters, value: Any) -> None:
    await parameters.set("/camera:new", value)
    assert await parameters.get("/camera:new") == value


async def test_refusal_of_the_node_is_an_error(parameters: Parameters) -> None:
    with pytest.raises(InvalidRequest, match="it is fixed"):
        await parameters.set("/camera:fixed", 1)
    with pytest.raises(InvalidRequest, match="bool, number or string"):
        await parameters.set("/camera:rate", {"a": 1})
    with pytest.raises(InvalidRequest, match="NODE:NAME"):
        await parameters.get("rate")


async def test_nodes_that_do_not_answer_have_no_names(parameters: Parameters) -> None:
    assert await parameters.names() == ["/camera:rate"]


async def test_values_of_all_parameters_are_read_at_once(parameters: Parameters) -> None:
    await parameters.set("/camera:on", True)
    assert await parameters.values() == {"/camera:rate": 5, "/camera:on": True}
    assert await parameters.values(["/camera:on", "/camera:none", "/dead:x"]) == {"/camera:on": True}


@pytest.mark.parametrize("count", [0, 2])
async def test_node_that_answers_for_other_parameters_is_named(count: int) -> None:
    async def ask(*_: Any) -> bytes:
        value = {"type": 2, "integer_value": 5}
        return msgspec.json.encode({"values": [value] * count, "results": [{"successful": True}] * count})

    parameters = Parameters(Node().graph, ask)
    with pytest.raises(RceError, match=f"node /odd answered for {count} parameters"):
        await parameters.set("/odd:rate", 5)
    with pytest.raises(RceError, match="not set" if count == 0 else "node /odd answered for 2 parameters"):
        await parameters.get("/odd:rate")


async def test_node_that_is_not_there_is_not_waited_for(parameters: Parameters) -> None:
    with pytest.raises(NotFound, match="no node /none with parameters"):
        await parameters.get("/none:rate")
    with pytest.raises(NotFound, match="no node /none with parameters"):
        await parameters.set("/none:rate", 5)
    assert await parameters.values(["/none:rate", "/camera:rate"]) == {"/camera:rate": 5}


async def test_node_that_has_just_started_is_found(node: Node, parameters: Parameters) -> None:
    node.age = 0.5
    assert await parameters.get("/camera:rate") == 5
