"""Egress as a text: what is one, and which addresses a list allows."""

from __future__ import annotations

import msgspec
import pytest

from rce.api.egress import Egress, targets


@pytest.mark.parametrize("text", ["none", "internet", "all", "10.0.0.5:5432", "10.0.0.5:1,192.0.2.0/28:65535"])
def test_egress(text: str) -> None:
    assert msgspec.convert(text, Egress) == text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "some",
        "host:80",
        "10.0.0.256:80",
        "10.0.0.5",
        "10.0.0.5:0",
        "10.0.0.5:65536",
        "10.0.0.5:80\n",
        "1.2.3.4/33:1",
    ],
)
def test_what_is_no_egress(text: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(text, Egress)


def test_targets() -> None:
    assert targets("internet") == []
    assert targets("10.0.0.5:5432,192.0.2.0/28:443") == [("10.0.0.5", "5432"), ("192.0.2.0/28", "443")]
