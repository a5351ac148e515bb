"""The commands of a robot: each waits until it is carried out, or raises the error that says why not.

With a server of the original they end when they are sent.
"""

from __future__ import annotations

import asyncio
from typing import Literal, TypedDict, Unpack

import msgspec

from rce.client.commands import Declared
from rce.client.session import Session
from rce.errors import AlreadyExists, InvalidRequest, RceError
from rce.messages import (
    AddInterface,
    AddNode,
    Command,
    Connect,
    ContainerData,
    CreateContainer,
    DeleteParameter,
    DestroyContainer,
    Disconnect,
    InterfaceType,
    ParameterValue,
    Qos,
    Rates,
    RemoveInterface,
    RemoveNode,
    SetParameter,
)

Format = Literal["png", "jpeg", "json"]


class EnvironmentOptions(TypedDict, total=False):
    """What an environment may be asked for; see `containerData` in docs/protocol.md.

    The `image` that it runs, `size` in slots of a machine, `cpu` in cores, `pids` as processes and threads, `memory`
    and `disk` in bytes, `bandwidth` and `io` in bytes a second, `env` for its nodes, `packages` of ROS 2, the network
    `group` it joins with `group_ip` in it, and whether it is started again when lost.
    """

    image: str
    size: int
    cpu: float
    memory: int
    pids: int
    disk: int
    bandwidth: int
    io: Rates
    gpus: int
    special_features: list[str]
    env: dict[str, str]
    packages: list[str]
    group: str
    group_ip: str
    restart: Literal["always", "no"]


class Operations:
    """What a robot may ask of the platform."""

    def __init__(self, session: Session, declared: Declared) -> None:
        self._session = session
        self._declared = declared

    async def create_environment(
        self, tag: str, *, exist_ok: bool = False, **options: Unpack[EnvironmentOptions]
    ) -> None:
        """Start an environment; with `exist_ok` one of that name that is there already will do."""
        try:
            await self.configure(CreateContainer(tag, _container_data(options)))
        except AlreadyExists:
            if not exist_ok:
                raise

    async def destroy_environment(self, tag: str) -> None:
        """Stop an environment with all that is in it."""
        await self.configure(DestroyContainer(tag))

    async def add_node(
        self, environment: str, tag: str, pkg: str, exe: str, *, args: str = "", name: str = "", namespace: str = ""
    ) -> None:
        """Start the executable `exe` of the ROS package `pkg`. `args` may use `$(find PKG)` and `$(env VAR)`."""
        await self.configure(AddNode(environment, tag, pkg, exe, args, name, namespace))

    async def remove_node(self, environment: str, tag: str) -> None:
        """Stop a node."""
        await self.configure(RemoveNode(environment, tag))

    async def set_parameter(self, environment: str, name: str, value: ParameterValue, *, node: str = "") -> None:
        """Set a parameter for nodes started later and running ones that declare it, or for `node` alone."""
        await self.configure(SetParameter(environment, name, value, node))

    async def delete_parameter(self, environment: str, name: str, *, node: str = "") -> None:
        """Forget a parameter."""
        await self.configure(DeleteParameter(environment, name, node))

    async def add_interface(
        self,
        endpoint: str,
        tag: str,
        interface_type: InterfaceType,
        type_name: str,
        *,
        addr: str = "",
        qos: Qos | None = None,
        format: Format = "png",
    ) -> None:
        """Add an interface to an environment or a robot; `publisher` and its like do this for the robot's own."""
        await self.configure(AddInterface(endpoint, tag, interface_type, type_name, addr, qos or Qos(), format))

    async def remove_interface(self, endpoint: str, tag: str) -> None:
        """Remove an interface and its connections."""
        await self.configure(RemoveInterface(endpoint, tag))

    async def connect(self, a: str, b: str) -> None:
        """Connect two interfaces, each `endpoint/interface`, in either order."""
        await self.configure(Connect(a, b))

    async def disconnect(self, a: str, b: str) -> None:
        """Take a connection away."""
        await self.configure(Disconnect(a, b))

    async def configure(self, *commands: Command) -> None:
        """Carry out many commands at once, in their order, without waiting for one before the next is sent.

        All are tried; then the first error is raised, and its `item` (`commands[2]`) says which it was.
        """
        outcomes = await asyncio.gather(*map(self._session.carry_out, commands), return_exceptions=True)
        failed: list[BaseException] = []
        for index, (command, outcome) in enumerate(zip(commands, outcomes, strict=True)):
            if outcome is None:
                self._declared.note(command)
            else:
                many = len(commands) > 1
                failed.append(outcome.at(f"commands[{index}]") if many and isinstance(outcome, RceError) else outcome)
        if failed:
            raise failed[0]


def _container_data(options: EnvironmentOptions) -> ContainerData:
    names = {"special_features": "specialFeatures", "group_ip": "groupIP"}
    try:
        return msgspec.convert({names.get(name, name): value for name, value in options.items()}, ContainerData)
    except msgspec.ValidationError as error:
        raise InvalidRequest(f"options of an environment: {error}") from None
