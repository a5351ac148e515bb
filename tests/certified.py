"""Certificates of machines, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rce.certificates import Authority, key_text, new_key, request
from rce.tls import CA, CERTIFICATE, KEY


def certify(directory: Path, authority: Authority, hosts: Sequence[str]) -> Path:
    """A machine's directory of certificates, which are for these names and addresses."""
    directory.mkdir(parents=True)
    key = new_key()
    (directory / CA).write_text(authority.certificate)
    (directory / KEY).write_text(key_text(key))
    (directory / CERTIFICATE).write_text(authority.issue(request(key, "machine"), "machine", hosts))
    return directory
