"""An environment of the platform, with the ends of its topics and services that one robot uses."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rce.errors import AlreadyExists
from rce.messages import InterfaceType, ParameterValue, Qos
from rce.names import is_guest

if TYPE_CHECKING:  # the robot makes environments
    from rce.client.operations import EnvironmentOptions, Format
    from rce.client.robot import Robot
    from rce.client.services import ServiceClient, ServiceProvider
    from rce.client.topics import Publisher, Subscriber


class Environment:
    """An environment, as one robot uses it. As an asynchronous context it is created, and destroyed at the end.

    `publisher` and its like wire a topic or service of the environment to the robot in one step. The interface in the
    environment gets a tag made from the topic's name; the robot's gets the same with the environment's name before it.
    Several robots may use one topic: the interface in the environment is then shared. A guest has its own.
    """

    def __init__(self, robot: Robot, tag: str, options: EnvironmentOptions) -> None:
        self.robot = robot
        self.tag = tag
        self._options = options

    async def __aenter__(self) -> Self:
        await self.robot.create_environment(self.tag, **self._options)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.destroy()

    async def destroy(self) -> None:
        """Stop the environment with all that is in it."""
        await self.robot.destroy_environment(self.tag)

    async def add_node(
        self, tag: str, pkg: str, exe: str, *, args: str = "", name: str = "", namespace: str = ""
    ) -> None:
        """See `Robot.add_node`."""
        await self.robot.add_node(self.tag, tag, pkg, exe, args=args, name=name, namespace=namespace)

    async def remove_node(self, tag: str) -> None:
        """Stop a node."""
        await self.robot.remove_node(self.tag, tag)

    async def set_parameter(self, name: str, value: ParameterValue, *, node: str = "") -> None:
        """See `Robot.set_parameter`."""
        await self.robot.set_parameter(self.tag, name, value, node=node)

    async def delete_parameter(self, name: str, *, node: str = "") -> None:
        """Forget a parameter."""
        await self.robot.delete_parameter(self.tag, name, node=node)

    async def publisher(
        self, topic: str, type_name: str, *, qos: Qos | None = None, raw: bool = False, format: Format = "png"
    ) -> Publisher:
        """The robot publishes on a topic of the environment."""
        to = await self._interface(topic, "pub", "PublisherInterface", type_name, qos)
        return await self.robot.publisher(self._own_tag(to), type_name, to=to, raw=raw, format=format, qos=qos)

    async def subscriber(
        self,
        topic: str,
        type_name: str,
        *,
        callback: Callable[[Any], Awaitable[None] | None] | None = None,
        depth: int = 10,
        qos: Qos | None = None,
        raw: bool = False,
        format: Format = "png",
    ) -> Subscriber:
        """The robot receives what is published on a topic of the environment."""
        to = await self._interface(topic, "sub", "SubscriberInterface", type_name, qos)
        return await self.robot.subscriber(
            self._own_tag(to), type_name, to=to, callback=callback, depth=depth, raw=raw, format=format, qos=qos
        )

    async def service_client(self, service: str, type_name: str, *, raw: bool = False) -> ServiceClient:
        """The robot calls a service of the environment."""
        to = await self._interface(service, "call", "ServiceClientInterface", type_name)
        return await self.robot.service_client(self._own_tag(to), type_name, to=to, raw=raw)

    async def service_provider(
        self, service: str, type_name: str, handler: Callable[[Any], Any], *, raw: bool = False
    ) -> ServiceProvider:
        """The robot offers a service to the nodes of the environment."""
        to = await self._interface(service, "serve", "ServiceProviderInterface", type_name)
        return await self.robot.service_provider(self._own_tag(to), type_name, handler, to=to, raw=raw)

    async def _interface(
        self, address: str, verb: str, interface_type: InterfaceType, type_name: str, qos: Qos | None = None
    ) -> str:
        """The `endpoint/interface` for an address of the environment, added unless it is there."""
        begin = f"{self.robot.name}." if is_guest(self.robot.name) else ""
        tag = f"{begin}{verb}_{re.sub(r'[^A-Za-z0-9_]+', '_', address).strip('_')}"
        with suppress(AlreadyExists):  # another robot's, or of an earlier run; of another type, connecting it fails
            await self.robot.add_interface(self.tag, tag, interface_type, type_name, addr=address, qos=qos)
        return f"{self.tag}/{tag}"

    def _own_tag(self, to: str) -> str:
        """The tag of the robot's end."""
        return to.replace(f"{self.robot.name}.", "").replace("/", "_")
