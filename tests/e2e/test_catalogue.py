"""The catalogue: a user publishes a service, robots of others use it, alone or together."""

from __future__ import annotations

import asyncio
import json
from contextlib import AsyncExitStack

import pytest

from rce.api.client import ApiClient
from rce.api.views import NewOffer, NewUser, OfferedNode, OfferView
from rce.client import Robot, Service
from rce.errors import NotFound
from tests.support.e2e.node import run_script
from tests.support.e2e.real_platform import RealPlatform, until
from tests.support.paths import TESTS

STRING = "std_msgs/String"
ECHO = OfferedNode("echo", "rce_demo", "echo", perRobot=True, args="--ros-args -r /say:=say -r /heard:=heard")
SHARED = NewOffer(
    name="parrot", takes={"say": STRING}, gives={"heard": STRING}, nodes=[ECHO], robots=15, most=3, idle=1.0
)
PASSWORD = "correct horse battery"


async def heard(service: Service, text: str) -> str:
    """Return what a service answers to a text."""
    await service.publisher("say").publish({"data": text})
    message = await service.subscriber("heard").get(60)
    return str(message["data"])


def robot(platform: RealPlatform, user: str, name: str) -> Robot:
    return Robot(platform.url, user=user, robot=name, password=PASSWORD, timeout=120)


@pytest.fixture
async def publisher(fragile: RealPlatform) -> ApiClient:
    """Client of the user ann, who publishes; bob is another user."""
    admin = ApiClient(fragile.url, user="admin", password="admin")
    for name in ("ann", "bob"):
        await asyncio.to_thread(admin.post, dict, "users", body=NewUser(name, PASSWORD))
    return ApiClient(fragile.url, user="ann", password=PASSWORD)


def show(client: ApiClient, name: str) -> OfferView:
    return client.get(OfferView, "catalogue", "ann", name)


async def test_twenty_robots_share_instances_that_come_and_go(fragile: RealPlatform, publisher: ApiClient) -> None:
    await asyncio.to_thread(publisher.post, OfferView, "catalogue", body=SHARED)
    async with AsyncExitStack() as stack:
        robots = [await stack.enter_async_context(robot(fragile, "bob", f"r{number}")) for number in range(20)]
        services = [await each.service("ann/parrot") for each in robots]
        texts = [str(number) for number in range(20)]
        assert await asyncio.gather(*map(heard, services, texts)) == texts
        view = await asyncio.to_thread(show, publisher, "parrot")
        assert sum(len(each.robots) for each in view.instances) == 20
        assert len(view.instances) == 2
        assert view.uses == {"bob": 20}
    await until(lambda: not show(publisher, "parrot").instances, what="the end of instances without robots")


async def test_program_in_javascript_uses_a_service(fragile: RealPlatform, publisher: ApiClient) -> None:
    await asyncio.to_thread(publisher.post, OfferView, "catalogue", body=SHARED)
    words = (str(TESTS / "js" / "service.mjs"), fragile.url, "bob", PASSWORD, "ann/parrot")
    status, out, err = await run_script(*words, timeout=120)
    assert status == 0, err
    assert json.loads(out) == {"data": "hello", "name": "ann/parrot", "shared": True}
    assert [each.robots for each in show(publisher, "parrot").instances] in ([[]], [])


async def test_instance_of_ones_own_is_an_environment_of_the_robots_user(
    fragile: RealPlatform, publisher: ApiClient
) -> None:
    node = OfferedNode("echo", "rce_demo", "echo")
    offer = NewOffer(name="echo", takes={"say": STRING}, gives={"heard": STRING}, nodes=[node], share=["bob"])
    await asyncio.to_thread(publisher.post, OfferView, "catalogue", body=offer)
    async with robot(fragile, "bob", "r2d2") as r2d2, robot(fragile, "ann", "c3po") as c3po:
        async with await r2d2.service("ann/echo", tag="mine") as service:
            assert await heard(service, "hello") == "hello"
            bob = ApiClient(fragile.url, user="bob", password=PASSWORD)
            environments = await asyncio.to_thread(bob.get, dict, "environments")
            assert [each["containerTag"] for each in environments["items"]] == ["mine"]
        with pytest.raises(NotFound):
            await c3po.service("bob/echo")
