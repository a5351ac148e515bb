"""Certificates of machines, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rce.net.certificates import Authority, generate_key, key_to_pem, signing_request
from rce.net.tls import CA, CERTIFICATE, KEY


def certify(
    directory: Path, authority: Authority, hosts: Sequence[str], name: str = "machine", after: float = 0.0
) -> Path:
    """A machine's directory of certificates, which are for these names and addresses and begin after a time."""
    directory.mkdir(parents=True)
    key = generate_key()
    (directory / CA).write_text(authority.certificate)
    (directory / KEY).write_text(key_to_pem(key))
    (directory / CERTIFICATE).write_text(authority.issue(signing_request(key, name), name, hosts, after))
    return directory
