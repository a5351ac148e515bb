"""URLs of a Robot endpoint: the one that it logs, and the one that it tells the Master."""

from __future__ import annotations

from pathlib import Path

import pytest

from endpoints.robot.__main__ import Settings, robot_url


@pytest.mark.parametrize(
    ("host", "url"),
    [("", "ws://:9010/"), ("127.0.0.1", "ws://127.0.0.1:9010/"), ("robots.example", "ws://robots.example:9010/")],
)
def test_url_has_host_and_port(host: str, url: str) -> None:
    assert robot_url(Settings(Path()), 9010, host) == url


def test_address_of_ipv6_is_in_brackets() -> None:
    assert robot_url(Settings(Path()), 9010, "::1") == "ws://[::1]:9010/"


def test_endpoint_with_certificate_has_wss_url() -> None:
    assert robot_url(Settings(Path(), certificate="cert.pem"), 9010, "localhost") == "wss://localhost:9010/"


@pytest.mark.parametrize("host", ["", "127.0.0.1"])
def test_public_url_takes_precedence(host: str) -> None:
    assert robot_url(Settings(Path(), public_url="wss://robots.example/"), 9010, host) == "wss://robots.example/"
