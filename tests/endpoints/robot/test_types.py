"""A user's own types, whose definitions may change while the Robot endpoint runs."""

from __future__ import annotations

import pytest
from msgspec import Raw

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.robot.types import UserTypes
from rce.control.calls.endpoints import InterfaceSpec
from rce.control.calls.robots import Definitions, Sort
from rce.errors import AlreadyExists, UnknownType
from rce.protocol.names import parse_type

NAME = "mine/msg/Thing"


class Environments:
    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.lookups: list[str] = []

    async def describe(self, name: str, sort: Sort) -> Definitions:
        self.lookups.append(name)
        if name not in self.texts:
            raise UnknownType(name)
        return Definitions({name: self.texts[name]})


@pytest.fixture
def environments() -> Environments:
    return Environments()


@pytest.fixture
def types(environments: Environments) -> UserTypes:
    return UserTypes(environments.describe)


def spec(type: str = NAME, kind: str = "PublisherConverter") -> InterfaceSpec:
    return InterfaceSpec("0" * 32, "ann/r1", "tag", kind, type)


def size(registry: TypeRegistry) -> int:
    """Return the size of a serialized message, which differs between the definitions of these tests."""
    return len(registry.message(parse_type(NAME)).encode(Wire(False, Raw(b'{"a": 1}'), {})))


async def test_common_types_are_not_looked_up(types: UserTypes, environments: Environments) -> None:
    await types.registry_for(spec("std_msgs/String"))
    await types.registry_for(spec("std_srvs/SetBool", "ServiceClientConverter"))
    assert environments.lookups == []


async def test_changed_definition_is_used_for_new_interfaces_only(types: UserTypes, environments: Environments) -> None:
    environments.texts[NAME] = "int32 a"
    before = await types.registry_for(spec())
    assert size(before) == 4 + 4
    environments.texts[NAME] = "float64 a"
    assert size(await types.registry_for(spec())) == 4 + 8
    assert size(before) == 4 + 4  # existing interfaces keep theirs


async def test_last_known_definition_is_used_without_environments(types: UserTypes, environments: Environments) -> None:
    environments.texts[NAME] = "int32 a"
    await types.registry_for(spec())
    del environments.texts[NAME]
    (await types.registry_for(spec())).message(parse_type(NAME))
    with pytest.raises(UnknownType):
        (await types.registry_for(spec("mine/msg/Other"))).message(parse_type("mine/msg/Other"))


async def test_redefinition_of_common_type_is_rejected(types: UserTypes, environments: Environments) -> None:
    environments.texts[NAME] = "int32 a"

    async def describe(name: str, sort: Sort) -> Definitions:
        return Definitions({name: "int32 a", "std_msgs/msg/String": "int32 data"})

    with pytest.raises(AlreadyExists):
        await UserTypes(describe).registry_for(spec())
