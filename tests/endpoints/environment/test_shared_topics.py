"""Topics that interfaces of one environment share."""

from __future__ import annotations

from typing import Any
from unittest.mock import Mock

from endpoints.data.frames import Message
from endpoints.environment.shared_topics import SharedTopics
from rce.control.calls.endpoints import InterfaceSpec

STRING = "std_msgs/String"


def spec(kind: str, addr: str, type_name: str = STRING) -> InterfaceSpec:
    return InterfaceSpec("1" * 32, "ann/brain", "tag", kind, type_name, addr)


def receiver(addr: str, type_name: str = STRING) -> Any:
    made = Mock()
    made.spec = spec("SubscriberInterface", addr, type_name)
    return made


def test_interfaces_of_the_same_topic_and_type_receive() -> None:
    topics = SharedTopics()
    same, relative, long = receiver("/chat"), receiver("chat"), receiver("/chat", "std_msgs/msg/String")
    other, another_type = receiver("/other"), receiver("/chat", "std_msgs/Int8")
    for each in (same, relative, long, other, another_type):
        topics.add(each)
    message, link = Message(b"\1" * 16, "1" * 32, b"\0\1\0\0"), Mock()
    topics.publish(spec("PublisherInterface", "/chat"), message, link, True)
    for each in (same, relative, long):
        each.receive_shared.assert_called_once_with(message, link, True)
    for each in (other, another_type):
        each.receive_shared.assert_not_called()


def test_removed_interface_receives_nothing() -> None:
    topics = SharedTopics()
    gone, stays = receiver("/chat"), receiver("/chat")
    topics.remove(gone)  # was never added
    topics.add(gone)
    topics.add(stays)
    topics.remove(gone)
    topics.publish(spec("PublisherInterface", "/chat"), Message(b"\1" * 16, "1" * 32, b"\0\1\0\0"), Mock(), False)
    gone.receive_shared.assert_not_called()
    stays.receive_shared.assert_called_once()
    topics.remove(stays)
    assert topics._receivers == {}
