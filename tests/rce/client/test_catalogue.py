"""Services of the catalogue at the robot: its interfaces, what came early, and the session after a loss."""

from __future__ import annotations

from typing import Any, cast

import pytest

from rce.client import Publisher, ServiceClient, Subscriber
from rce.client.catalogue import Service
from rce.client.connection import Message
from rce.client.declarations import Declarations
from rce.client.dispatcher import Dispatcher
from rce.client.interface import Owner
from rce.client.session import ClientSession
from rce.errors import AlreadyExists, NotFound, RceError, Unavailable
from rce.protocol import messages as m

STRING = "std_msgs/String"
USED = m.UsedService(
    "ann/parrot",
    "parrot",
    True,
    [
        m.UsedInterface("say", "parrot_say", "SubscriberConverter", STRING),
        m.UsedInterface("heard", "parrot_heard", "PublisherForwarder", STRING),
        m.UsedInterface("reset", "parrot_reset", "ServiceProviderConverter", "std_srvs/Empty"),
    ],
)


class Platform:
    """Robot and session in one; `early` comes before the acknowledgement."""

    name = "r1"
    connection = cast(Any, object())

    def __init__(self) -> None:
        self.declarations = Declarations("r1")
        self.dispatcher = Dispatcher("r1", self.declarations)
        self.commands: list[m.Command] = []
        self.early: list[m.InterfaceStatus] = []
        self.answer: m.Ack | RceError = m.Ack([USED])

    async def execute(self, command: m.Command) -> m.Ack:
        self.commands.append(command)
        for status in self.early:
            self.dispatcher.status_received(status)
        if isinstance(self.answer, RceError):
            raise self.answer
        return self.answer

    async def use(self, name: str = "ann/parrot", tag: str = "") -> Service:
        session = cast(ClientSession, self)
        return await Service.use(cast(Owner, self), session, self.declarations, self.dispatcher, name, tag, False)


async def test_robot_gets_an_interface_of_each_kind() -> None:
    platform = Platform()
    service = await platform.use()
    assert platform.commands == [m.UseService("ann/parrot", "parrot")]
    assert isinstance(service.publisher("say"), Publisher)
    assert isinstance(service.subscriber("heard"), Subscriber)
    assert isinstance(service.service_client("reset"), ServiceClient)
    assert all(each.connected for each in service.interfaces.values())
    for wrong in (lambda: service.publisher("heard"), lambda: service.action_client("say")):
        with pytest.raises(NotFound):
            wrong()


async def test_what_comes_before_the_acknowledgement_is_not_lost() -> None:
    platform = Platform()
    platform.early = [m.InterfaceStatus("parrot_say", True), m.InterfaceStatus("parrot_say", False)]
    service = await platform.use()
    assert not service.publisher("say").connected
    assert service.subscriber("heard").connected


async def test_messages_for_nobody_are_dropped_after_a_refusal() -> None:
    platform = Platform()
    platform.answer = NotFound("there is no such service")
    with pytest.raises(NotFound):
        await platform.use()
    platform.dispatcher.message_received(Message(m.DataMessage("parrot_heard", STRING, "1"), {}))
    assert platform.declarations.commands() == []


async def test_service_is_asked_for_again_in_a_new_session_until_it_is_left() -> None:
    platform = Platform()
    async with await platform.use() as service:
        assert platform.declarations.commands() == [m.UseService("ann/parrot", "parrot")]
        with pytest.raises(AlreadyExists):
            await platform.use("bob/parrot")
    assert platform.commands[-1] == m.LeaveService("parrot")
    assert platform.declarations.commands() == []
    assert not service.publisher("say").connected


async def test_leaving_what_is_gone_is_no_error() -> None:
    platform = Platform()
    service = await platform.use()
    platform.answer = NotFound("gone")
    await service.leave()
    assert platform.declarations.services == {}


async def test_older_platform_is_named() -> None:
    platform = Platform()
    platform.answer = m.Ack()
    with pytest.raises(Unavailable, match="older"):
        await platform.use()
