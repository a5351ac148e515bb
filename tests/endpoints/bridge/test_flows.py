"""Flows between the robot's ROS and an environment, with fakes of both."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from twisted.logger import LogEvent, globalLogPublisher

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.bridge.config import BridgeConfig, Service, Topic
from endpoints.bridge.filters import TF
from endpoints.bridge.flows import CalledService, OfferedService, ReceivedTopic, SentTopic, make_flows
from endpoints.bridge.local_ros import CLOUD
from endpoints.data.interface import error_of
from endpoints.environment.service_calls import TIMEOUT
from endpoints.environment.services import ServiceClientInterface, ServiceProviderInterface
from endpoints.environment.topics import PublisherInterface, SubscriberInterface
from rce.client import Environment, Store
from rce.errors import ConversionError, NotFound, RceError
from rce.protocol.blobs import Buffer
from rce.protocol.messages import Qos
from tests.support.endpoints.fake_local_ros import FakeLocalRos

STRING, TRIGGER = "std_msgs/String", "std_srvs/Trigger"


class FakeEnvironment:
    """Environment and all of its interfaces: the newest of each kind is used."""

    def __init__(self) -> None:
        self.opened: list[tuple[str, str]] = []
        self.options: dict[str, Any] = {}
        self.offered: list[tuple[bytes, int]] = []
        self.dropped = 0
        self.drops_of_next_offer = 0
        self.receive: Callable[[Buffer], None]
        self.serve: Callable[[Buffer], Awaitable[bytes]]
        self.calls: list[tuple[bytes, float]] = []
        self.answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()

    async def publisher(self, topic: str, type_name: str, **options: Any) -> FakeEnvironment:
        self.opened.append((topic, type_name))
        self.options = options
        return self

    def offer(self, value: bytes, keep: int) -> bool:
        self.offered.append((value, keep))
        self.dropped += self.drops_of_next_offer
        return True

    async def subscriber(
        self, topic: str, type_name: str, *, callback: Callable[[Buffer], None], **options: Any
    ) -> None:
        self.opened.append((topic, type_name))
        self.receive, self.options = callback, options

    async def service_provider(
        self, service: str, type_name: str, handler: Callable[[Buffer], Awaitable[bytes]], *, raw: bool
    ) -> None:
        assert raw
        self.opened.append((service, type_name))
        self.serve = handler

    async def service_client(self, service: str, type_name: str, *, raw: bool) -> FakeEnvironment:
        assert raw
        self.opened.append((service, type_name))
        return self

    async def call(self, request: bytes, seconds: float) -> bytes:
        self.calls.append((request, seconds))
        return await self.answer


@pytest.fixture
async def sky() -> FakeEnvironment:
    return FakeEnvironment()


def environment(fake: FakeEnvironment) -> Environment:
    return cast(Environment, fake)


def reject(_: Buffer) -> None:
    raise ConversionError("not an image")


async def test_message_of_robot_is_published_in_environment(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    flow = SentTopic(Topic("/scan", STRING, to="/rover/scan", qos=Qos(depth=3)))
    await flow.open(local, environment(sky))
    there = local.interfaces["/scan"]
    assert (there.make, there.qos, sky.opened) == (SubscriberInterface, Qos(depth=3), [("/rover/scan", STRING)])
    assert sky.options["raw"]
    there.send(memoryview(b"one"), keep=3)
    there.send(b"two", keep=None)
    assert sky.offered == [(b"one", 3), (b"two", 1)]


async def test_messages_that_give_way_to_newer_ones_are_counted(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    await SentTopic(Topic("/scan", STRING)).open(local, environment(sky))
    assert local.interfaces["/scan"].send(b"one") == 0
    sky.drops_of_next_offer = 2
    assert local.interfaces["/scan"].send(b"two") == 2


async def test_sent_messages_beyond_rate_are_left_out(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    await SentTopic(Topic("/scan", STRING, rate=0.001)).open(local, environment(sky))
    assert [local.interfaces["/scan"].send(payload) for payload in (b"one", b"two")] == [0, 0]
    assert sky.offered == [(b"one", 1)]


async def test_message_that_filter_leaves_out_is_not_sent(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    flow = SentTopic(Topic("/tf", STRING), lambda cdr: None if cdr == b"wheel" else b"kept")
    await flow.open(local, environment(sky))
    for payload in (b"wheel", b"base"):
        local.interfaces["/tf"].send(payload)
    assert sky.offered == [(b"kept", 1)]


async def test_same_conversion_error_is_logged_once(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    logged: list[LogEvent] = []
    await SentTopic(Topic("/camera", STRING), reject).open(local, environment(sky))
    globalLogPublisher.addObserver(logged.append)  # type: ignore[arg-type]  # mypy does not know zope's interfaces
    try:
        for _ in range(3):
            assert local.interfaces["/camera"].send(b"junk") == 0
    finally:
        globalLogPublisher.removeObserver(logged.append)  # type: ignore[arg-type]
    assert [event["error"] for event in logged] == ["not an image"]
    assert sky.offered == []


async def test_images_are_compressed_on_the_way(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    image = Topic("/camera", "sensor_msgs/Image", format="jpeg")
    await SentTopic(image).open(local, environment(sky))
    assert (sky.options["raw"], sky.options["format"]) == (False, "jpeg")
    await ReceivedTopic(image).open(local, environment(sky))
    assert (sky.options["raw"], sky.options["format"]) == (False, "jpeg")


async def test_message_of_environment_is_published_at_robot(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    flow = ReceivedTopic(Topic("/map", STRING, to="/cloud_map", qos=Qos(depth=2)))
    await flow.open(local, environment(sky))
    there = local.interfaces["/cloud_map"]
    assert (there.make, there.qos, sky.opened) == (PublisherInterface, Qos(depth=2), [("/map", STRING)])
    assert (sky.options["depth"], sky.options["raw"]) == (2, True)
    sky.receive(b"first")
    assert there.payloads() == [b"first"]
    assert (there.traffic.of(CLOUD).messages, there.traffic.of(CLOUD).bytes) == (1, 5)


async def test_received_messages_are_limited_and_filtered(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    await ReceivedTopic(Topic("/slow", STRING, rate=0.001)).open(local, environment(sky))
    for payload in (b"one", b"two"):
        sky.receive(payload)
    await ReceivedTopic(Topic("/bad", STRING), reject).open(local, environment(sky))
    sky.receive(b"junk")
    await ReceivedTopic(Topic("/tf", STRING), lambda cdr: None).open(local, environment(sky))
    sky.receive(b"wheel")
    assert {name: each.payloads() for name, each in local.interfaces.items()} == {
        "/slow": [b"one"],
        "/bad": [],
        "/tf": [],
    }


async def test_ended_flow_delivers_nothing_and_its_interface_is_removed(
    local: FakeLocalRos, sky: FakeEnvironment
) -> None:
    flow = ReceivedTopic(Topic("/map", STRING))
    flow.end()  # it is not open yet
    await flow.open(local, environment(sky))
    there = local.interfaces["/map"]
    for _ in range(2):
        flow.end()
    assert local.interfaces == {}
    sky.receive(b"late")
    assert there.received == []


async def test_node_of_environment_calls_service_of_robot(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    await OfferedService(Service("/land", TRIGGER, to="/rover/land")).open(local, environment(sky))
    there = local.interfaces["/land"]
    assert (there.make, sky.opened) == (ServiceClientInterface, [("/rover/land", TRIGGER)])
    calls = [asyncio.ensure_future(sky.serve(request)) for request in (b"one", b"two", b"three")]
    await asyncio.sleep(0)
    assert there.payloads() == [b"one", b"two", b"three"]
    first, second, third = (message.msg_id for message in there.received)
    there.send(b"answer to two", second)
    there.fail(third, NotFound("no legs"))
    there.send(b"answer to one", first)
    assert await asyncio.gather(*calls[:2]) == [b"answer to one", b"answer to two"]
    with pytest.raises(NotFound, match="no legs"):
        await calls[2]
    assert there.send(b"again", first) == 0, "a second response is ignored"


async def test_node_of_robot_calls_service_of_environment(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    await CalledService(Service("/plan", TRIGGER, to="/cloud/plan")).open(local, environment(sky))
    there = local.interfaces["/cloud/plan"]
    assert (there.make, sky.opened) == (ServiceProviderInterface, [("/plan", TRIGGER)])
    there.send(b"request", "7")
    sky.answer.set_result(b"response")
    await until(lambda: bool(there.received))
    (answer,) = there.received
    assert (answer.msg_id, answer.payload, answer.error) == ("7", b"response", False)
    assert sky.calls == [(b"request", TIMEOUT)]


async def test_failed_call_of_robot_is_answered_with_its_error(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    await CalledService(Service("/plan", TRIGGER)).open(local, environment(sky))
    there = local.interfaces["/plan"]
    there.send(b"request", "7")
    sky.answer.set_exception(RceError("no plan"))
    await until(lambda: bool(there.received))
    (answer,) = there.received
    assert (answer.msg_id, answer.error, str(error_of(answer))) == ("7", True, "no plan")


async def test_ended_service_cancels_its_calls(local: FakeLocalRos, sky: FakeEnvironment) -> None:
    flow = CalledService(Service("/plan", TRIGGER))
    await flow.open(local, environment(sky))
    there = local.interfaces["/plan"]
    there.send(b"request", "7")
    await until(lambda: bool(sky.calls))
    flow.end()
    await until(sky.answer.cancelled)
    assert there.received == []


async def until(condition: Callable[[], bool]) -> None:
    """Let tasks run until a condition holds."""
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110  # it takes a few turns of the loop
            await asyncio.sleep(0)


async def test_every_entry_of_configuration_is_a_flow(make_config: Callable[..., BridgeConfig]) -> None:
    way = {
        "topics": [{"topic": "/a", "type": STRING}],
        "services": [{"service": "/b", "type": TRIGGER}],
        "tf": {"frames": ["base_link"], "rate": 20},
    }
    flows = list(make_flows(make_config(send=way, receive=way)))
    kinds = [SentTopic, ReceivedTopic, OfferedService, CalledService, SentTopic, SentTopic, *[ReceivedTopic] * 2]
    assert [type(flow) for flow in flows] == kinds
    assert list(make_flows(make_config())) == []


async def test_static_transforms_are_latched_and_have_no_rate_limit(
    local: FakeLocalRos, sky: FakeEnvironment, make_config: Callable[..., BridgeConfig]
) -> None:
    for flow in make_flows(make_config(send={"tf": {"frames": ["base_link"], "rate": 0.001}})):
        await flow.open(local, environment(sky))
    assert {name: each.qos.durability for name, each in local.interfaces.items() if each.qos} == {
        "/tf": "auto",
        "/tf_static": "transient_local",
    }
    for name, count in (("/tf", 1), ("/tf_static", 2)):
        sky.offered.clear()
        for _ in range(2):
            local.interfaces[name].send(transform("base_link"))
        assert len(sky.offered) == count, name


def transform(frame: str) -> Buffer:
    """Return a `tf2_msgs/TFMessage` as CDR."""
    text = msgspec.json.encode({"transforms": [{"child_frame_id": frame}]})
    return TypeRegistry().message(TF).encode(Wire(False, text, {}))


async def test_sent_topic_passes_its_treatment_of_messages_while_offline(tmp_path: Path) -> None:
    for offline, store, given in (("newest", None, "newest"), ("store", tmp_path / "s", Store(tmp_path / "s"))):
        local, environment = FakeLocalRos(), FakeEnvironment()
        flow = SentTopic(Topic("/log", STRING, offline=cast(Any, offline), store=store))
        await flow.open(cast(Any, local), cast(Environment, environment))
        assert environment.options["offline"] == given
