"""Addresses of topics and services."""

from __future__ import annotations

import pytest

from rce.cli.lazy.guest import split_address
from rce.errors import InvalidRequest


@pytest.mark.parametrize("address", ["brain/odom", "brain//odom"])
def test_address_is_environment_and_ros_name(address: str) -> None:
    assert split_address(address) == ("brain", "/odom")


@pytest.mark.parametrize("address", ["brain", "brain/", "/odom", ""])
def test_incomplete_address_is_refused(address: str) -> None:
    with pytest.raises(InvalidRequest, match="ENV/NAME"):
        split_address(address)
