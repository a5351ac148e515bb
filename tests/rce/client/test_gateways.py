"""WebSockets of the gateways."""

from __future__ import annotations

from contextlib import suppress
from urllib.parse import parse_qs, urlsplit

import pytest

from rce.client.address import Address
from rce.client.gateways import dial_gateway
from rce.errors import Unavailable
from tests.support.fake_platform import KEY, FakePlatform


async def test_gateway_is_dialled_at_its_path_with_the_credentials(fake: FakePlatform) -> None:
    address = Address(fake.url, "testUser", "", key=KEY, owner="ann")
    with suppress(Unavailable):  # the fake has no gateways
        await (await dial_gateway(address, "rosbridge", "brain")).close()
    path = urlsplit(fake.request_paths[-1])
    assert path.path == "/rosbridge/ann/brain"
    assert parse_qs(path.query) == {"userID": ["testUser"], "key": [KEY]}


async def test_refusal_of_a_gateway_has_its_reason() -> None:
    with pytest.raises(Unavailable, match="cannot reach"):
        await dial_gateway(Address("http://127.0.0.1:9/", "testUser", "", key=KEY), "rosbridge", "brain")
