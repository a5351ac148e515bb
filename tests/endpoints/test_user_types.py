"""A user's own types, which may change while the Robot endpoint lives."""

from __future__ import annotations

import pytest
from msgspec import Raw

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.robot.types import UserTypes
from rce.calls.endpoints import InterfaceSpec
from rce.calls.robots import Definitions
from rce.errors import AlreadyExists, UnknownType
from rce.names import parse_type

NAME = "mine/msg/Thing"


class Environments:
    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.asked: list[str] = []

    async def describe(self, name: str, service: bool) -> Definitions:
        self.asked.append(name)
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
    """Of a message as bytes: it tells the definitions of these tests apart."""
    return len(registry.message(parse_type(NAME)).encode(Wire(False, Raw(b'{"a": 1}'), {})))


async def test_common_types_are_not_asked_for(types: UserTypes, environments: Environments) -> None:
    await types.of(spec("std_msgs/String"))
    await types.of(spec("std_srvs/SetBool", "ServiceClientConverter"))
    assert environments.asked == []


async def test_a_type_that_changes(types: UserTypes, environments: Environments) -> None:
    environments.texts[NAME] = "int32 a"
    before = await types.of(spec())
    assert size(before) == 4 + 4
    environments.texts[NAME] = "float64 a"
    assert size(await types.of(spec())) == 4 + 8
    assert size(before) == 4 + 4  # what was made with it goes on


async def test_a_type_that_no_environment_has_just_now(types: UserTypes, environments: Environments) -> None:
    environments.texts[NAME] = "int32 a"
    await types.of(spec())
    del environments.texts[NAME]
    (await types.of(spec())).message(parse_type(NAME))
    with pytest.raises(UnknownType):
        (await types.of(spec("mine/msg/Other"))).message(parse_type("mine/msg/Other"))


async def test_what_redefines_a_common_type(types: UserTypes, environments: Environments) -> None:
    environments.texts[NAME] = "int32 a"

    async def describe(name: str, service: bool) -> Definitions:
        return Definitions({name: "int32 a", "std_msgs/msg/String": "int32 data"})

    with pytest.raises(AlreadyExists):
        await UserTypes(describe).of(spec())
