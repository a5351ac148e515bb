"""TLS between machines: each proves by a certificate of the platform's own CA which one it is.

A directory has `ca.pem`, and this machine's `cert.pem` and `key.pem`. Who dials checks that the certificate is for the
name or address that it dialled; who is dialled, that the caller has one at all. Data links use it from here; control
connections, which are Twisted's, through `rce.control_tls`.
"""

from __future__ import annotations

import re
import ssl
from ipaddress import ip_address
from pathlib import Path

from rce.errors import InvalidRequest

CA, CERTIFICATE, KEY = "ca.pem", "cert.pem", "key.pem"  # the files of a machine's directory

PLAIN = (
    "{what} is taken at {host} without TLS: whoever sees the network between the machines can read and change it; give "
    "each machine a certificate (setting tls)"
)
_INTERFACE = re.compile(r":interface=((?:[^:\\]|\\.)*)")


class Tls:
    """The certificates of one machine. Raises InvalidRequest if they cannot be used."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        ca = directory / CA
        try:
            self.server = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=ca)
            self.client = ssl.create_default_context(ssl.Purpose.SERVER_AUTH, cafile=ca)
            self.server.verify_mode = ssl.CERT_REQUIRED
            for context in (self.server, self.client):
                context.minimum_version = ssl.TLSVersion.TLSv1_2
                context.load_cert_chain(directory / CERTIFICATE, directory / KEY)
        except (OSError, ssl.SSLError) as error:
            files = f"{CA}, {CERTIFICATE} and {KEY}"
            raise InvalidRequest(f"tls {directory}: {files} cannot be used: {error}", field="tls") from None


def load(directory: Path | None) -> Tls | None:
    """The certificates in `directory`, or None without one. InvalidRequest."""
    return Tls(directory) if directory else None


def public(certificate: str, private_key: str = "") -> ssl.SSLContext | None:
    """What robots and browsers are served with: PEM files, the key in the first if not given; None without a
    certificate. InvalidRequest."""
    if not certificate:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, private_key or None)
    except (OSError, ssl.SSLError) as error:
        raise InvalidRequest(f"certificate {certificate}: {error}", field="certificate") from None
    return context


def exposed(host: str, tls: Tls | None) -> bool:
    """Whether others in the network could read and change what is taken at `host`; then PLAIN is to be logged."""
    return tls is None and not _is_loopback(host)


def interface(description: str) -> str:
    """The address at which a Twisted server endpoint listens; empty for all."""
    if description.startswith("unix:"):
        return "localhost"
    found = _INTERFACE.search(description)
    return re.sub(r"\\(.)", r"\1", found[1]) if found else ""


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
