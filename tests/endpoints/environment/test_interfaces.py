"""Behaviour that interfaces of an environment have in common: errors of ROS, and reports to their owner."""

from __future__ import annotations

import errno
from collections.abc import Callable

import msgspec
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from endpoints.data.frames import Message
from endpoints.data.link import Link
from endpoints.environment.interfaces import MAX_REPORTED, RosInterface, as_bytes
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, InvalidRequest, LimitExceeded, NotFound, RceError
from tests.support.endpoints.fake_ros import InstantRos

SPEC = InterfaceSpec("0a" * 16, "ann/env", "tag", "PublisherInterface", "a/B", "a b")


class Plain(RosInterface):
    def create(self, make: Callable[[], str]) -> str:
        return self._create(make)

    def report(self, error: RceError) -> None:
        self._report_once(error)

    def report_from_ros(self, reason: str) -> None:
        self._report_from_ros(ConversionError, reason)

    def receive(self, message: Message, link: Link) -> None: ...


@pytest.fixture
def reports() -> list[RceError]:
    return []


@pytest.fixture
def interface(reports: list[RceError]) -> Plain:
    def report(spec: InterfaceSpec, error: RceError) -> None:
        assert spec is SPEC
        reports.append(error)

    return Plain(SPEC, InstantRos().context(report))


@pytest.mark.parametrize(
    "error",
    [
        InvalidTopicNameException("a b", "must not\n  contain spaces", 1),
        InvalidServiceNameException("a b", "must not contain spaces", 1),
        ValueError("must not contain spaces"),
        _rclpy.RCLError("must not contain spaces"),
    ],
)
async def test_name_that_ros_rejects_is_invalid_request(interface: Plain, error: Exception) -> None:
    def fail() -> str:
        raise error

    with pytest.raises(
        InvalidRequest, match=r"interface tag: ROS rejects addr 'a b': .*must not contain spaces"
    ) as got:
        interface.create(fail)
    assert got.value.info.field == "addr"
    assert "\n" not in str(got.value)


async def test_missing_name_is_invalid_request() -> None:
    def fail() -> str:
        raise InvalidTopicNameException("", "must not be empty", 0)

    plain = Plain(msgspec.structs.replace(SPEC, addr=""), InstantRos().context(lambda *_: None))
    with pytest.raises(InvalidRequest, match="interface tag: a PublisherInterface needs addr: a topic"):
        plain.create(fail)


async def test_interface_without_a_descriptor_is_one_too_many(interface: Plain) -> None:
    def fail() -> str:
        raise OSError(errno.EMFILE, "Too many open files")

    with pytest.raises(LimitExceeded, match="too many interfaces"):
        interface.create(fail)


async def test_other_errors_are_passed_on(interface: Plain) -> None:
    def fail() -> str:
        raise MemoryError

    with pytest.raises(MemoryError):
        interface.create(fail)


def test_same_error_is_reported_once(interface: Plain, reports: list[RceError]) -> None:
    for _ in range(3):
        interface.report(NotFound("one"))
    interface.report(NotFound("other"))
    assert [str(error) for error in reports] == ["one", "other"]


def test_number_of_different_reports_is_limited(interface: Plain, reports: list[RceError]) -> None:
    for number in range(MAX_REPORTED + 50):
        interface.report(NotFound(str(number)))
    assert len(reports) == MAX_REPORTED


def test_report_from_ros_names_the_interface(interface: Plain, reports: list[RceError]) -> None:
    interface.report_from_ros("not serialized as CDR")
    (error,) = reports
    assert (type(error), str(error)) == (ConversionError, "interface tag: not serialized as CDR")


def test_bytes_are_not_copied() -> None:
    payload = b"abc"
    assert as_bytes(payload) is payload
    assert [as_bytes(other) for other in (bytearray(payload), memoryview(payload))] == [payload, payload]
