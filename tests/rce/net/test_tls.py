"""Certificates of a machine, and the listening addresses that need TLS."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.errors import InvalidRequest
from rce.net.certificates import Authority
from rce.net.tls import CA, CERTIFICATE, KEY, Tls, is_exposed, listening_address, load_tls
from tests.support.certificates import certify


@pytest.fixture
def own(tmp_path: Path) -> Tls:
    return Tls(certify(tmp_path / "own", Authority.make("test"), ["127.0.0.1"]))


@pytest.mark.parametrize("broken", [CA, CERTIFICATE, KEY])
def test_error_names_unusable_files(own: Tls, broken: str) -> None:
    (own.directory / broken).write_text("nonsense")
    with pytest.raises(InvalidRequest, match=str(own.directory)):
        load_tls(own.directory)
    (own.directory / broken).unlink()
    with pytest.raises(InvalidRequest, match=broken):
        load_tls(own.directory)


def test_plain_port_is_exposed_unless_it_is_local(own: Tls) -> None:
    for host, exposed in (("127.0.0.1", False), ("::1", False), ("10.0.0.1", True), ("", True), ("m1", True)):
        assert is_exposed(host, None) == exposed
        assert not is_exposed(host, own)


@pytest.mark.parametrize(
    ("description", "address"),
    [
        ("tcp:8080", ""),
        (r"tcp:8080:interface=\:\:1", "::1"),
        ("tcp:8080:interface=10.0.0.1:backlog=5", "10.0.0.1"),
        ("unix:/run/rce.sock", "localhost"),
    ],
)
def test_listening_address_of_an_endpoint(description: str, address: str) -> None:
    assert listening_address(description) == address
