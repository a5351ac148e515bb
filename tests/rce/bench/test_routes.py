"""Routes between a robot and a node."""

from __future__ import annotations

import base64
from contextlib import AsyncExitStack
from typing import Any

import pytest

from rce.bench import routes
from rce.bench.nodes import Place
from rce.bench.payloads import IMAGE, IMAGES, ROW, SERVICES, TOPICS, data
from rce.bench.routes import DEFAULT_ROUTES, ROUTES, check, r2c, r2r, service_echo, topic_echo
from rce.errors import ConversionError
from tests.support.bench import FakeEnvironment, FakeRobot, Topic, fake_place

FORWARDER = next(payload for payload in TOPICS if payload.name == "forwarder")
CALL = next(call for call in SERVICES if call.name == "json")


class Service:
    """Service whose answer has the content of the request, shortened by `missing` characters."""

    def __init__(self, missing: int = 0) -> None:
        self.calls: list[dict[str, str]] = []
        self.missing = missing

    async def call(self, request: dict[str, str], timeout: float) -> dict[str, str]:  # noqa: ASYNC109
        self.calls.append(request)
        text = request["load_namespace"]
        return {"message": text[: len(text) - self.missing]}


def echo(environment: FakeEnvironment, robot: FakeRobot, missing: int = 0) -> Topic:
    """Let the node return each message of /r2c/forwarder, shortened by so many bytes; return the topic."""
    back = robot.topics.setdefault("bench/back_forwarder", Topic())
    out = Topic(lambda message: back.messages.append(message[: len(message) - missing]))
    environment.topics["/r2c/forwarder"] = out
    return out


def as_received(message: Any) -> Any:
    """Return a message as a robot gets it, whose blobs are base64."""
    if isinstance(message, dict) and isinstance(message["data"], bytes):
        return {"data": base64.b64encode(message["data"]).decode()}
    return message


@pytest.fixture
async def place() -> Any:
    async with AsyncExitStack() as stack:
        yield fake_place(stack)


async def test_message_of_a_topic_is_sent_and_received_back(
    place: tuple[Place, FakeEnvironment, FakeRobot],
) -> None:
    here, environment, robot = place
    out = echo(environment, robot)
    sample = await topic_echo(here, FORWARDER, "/r2c/forwarder")
    assert await sample(2 * ROW) > 0
    assert out.sent == [FORWARDER.make(ROW), FORWARDER.make(2 * ROW)]
    assert ("subscriber", "bench/back_forwarder", True, "png") in robot.log
    assert ("interface", "bench/back_forwarder", "SubscriberInterface", "/r2c/forwarder_back") in robot.log


async def test_shortened_message_is_an_error(place: tuple[Place, FakeEnvironment, FakeRobot]) -> None:
    here, environment, robot = place
    echo(environment, robot, missing=ROW)
    with pytest.raises(ConversionError, match="/r2c/forwarder: the answer has"):
        await topic_echo(here, FORWARDER, "/r2c/forwarder")


async def test_service_is_called_with_the_size(place: tuple[Place, FakeEnvironment, FakeRobot]) -> None:
    here, environment, _ = place
    service = environment.topics["/r2c/call_json"] = Service()
    sample = await service_echo(here, CALL, "/r2c/call_json")
    assert await sample(100) > 0
    assert [len(each["load_namespace"]) for each in service.calls] == [ROW, 100]
    service.missing = 1
    with pytest.raises(ConversionError, match="has 99 of 100 bytes"):
        await sample(100)


def test_longer_answer_is_accepted() -> None:
    check("/topic", data(11), 10)


async def test_robot_is_compared_with_nodes_of_the_same_kind(
    place: tuple[Place, FakeEnvironment, FakeRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def sampled(*arguments: object) -> Any:
        return None

    monkeypatch.setattr(routes, "topic_echo", sampled)
    monkeypatch.setattr(routes, "service_echo", sampled)
    probes = {probe.name: probe for probe in await r2c(place[0])}
    assert probes["r2c json"].beside == "n2n string"
    assert probes["r2c blob"].beside == probes["r2c forwarder"].beside == "n2n bytes"
    assert {name for name, probe in probes.items() if probe.size == IMAGE} == {f"r2c {each.name}" for each in IMAGES}
    assert probes["r2c service json"].transport == "service"
    ((_, _, tag, executable, words),) = place[1].log
    assert (tag, executable) == ("r2c_echo", "echo")
    assert "blob:bytes" in words.split()
    assert "call_forwarder:service" in words.split()


async def test_robot_sends_to_itself_without_an_environment(place: tuple[Place, FakeEnvironment, FakeRobot]) -> None:
    here, environment, robot = place
    for payload in TOPICS:
        back = robot.topics[f"r2r_{payload.name}_back"] = Topic()
        robot.topics[f"r2r_{payload.name}"] = Topic(lambda sent, back=back: back.messages.append(as_received(sent)))
    probes = await r2r(here)
    assert [each.name for each in probes] == [f"r2r {payload.name}" for payload in TOPICS]
    assert await probes[0].sample(100) > 0
    assert ("publisher", "r2r_json", "bench/r2r_json_back") in robot.log
    assert {kind for kind, *_ in environment.log} == {"publisher", "subscriber"}


def test_default_routes_exist() -> None:
    assert set(DEFAULT_ROUTES) <= set(ROUTES)
