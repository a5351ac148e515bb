"""Mutual TLS between machines, with certificates of the platform's own CA.

The directory of a machine has `ca.pem`, and the machine's `cert.pem` and `key.pem`. The connecting side checks that the
certificate is valid for the name or address that it dialled; the accepting side requires any certificate of the CA.
Data links use the contexts of this module; control connections, which are Twisted's, use `rce.control.tls`.
"""

from __future__ import annotations

import re
import ssl
from ipaddress import ip_address
from pathlib import Path

from rce.errors import InvalidRequest

CA, CERTIFICATE, KEY = "ca.pem", "cert.pem", "key.pem"  # the files of a machine's directory

PLAINTEXT_WARNING = (
    "{what} is accepted at {host} without TLS: anybody with access to the network between the machines can read and "
    "change it; give each machine a certificate (setting tls)"
)
_INTERFACE = re.compile(r":interface=((?:[^:\\]|\\.)*)")


class Tls:
    """TLS contexts with the certificates of one machine.

    Attributes:
        directory: The directory with the certificates.
        server: Context for accepting connections.
        client: Context for opening connections.

    Raises:
        InvalidRequest: The files cannot be used.
    """

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


def load_tls(directory: Path | None) -> Tls | None:
    """Load the certificates in `directory`; return None if there is no directory.

    Raises:
        InvalidRequest: The files cannot be used.
    """
    return Tls(directory) if directory else None


def public_tls_context(certificate: str, private_key: str = "") -> ssl.SSLContext | None:
    """Load the certificate that robots and browsers see; return None if there is no certificate.

    Args:
        certificate: PEM file with the certificate and its chain; empty for none.
        private_key: PEM file with the key; empty if the key is in `certificate`.

    Raises:
        InvalidRequest: The files cannot be used.
    """
    if not certificate:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, private_key or None)
    except (OSError, ssl.SSLError) as error:
        raise InvalidRequest(f"certificate {certificate}: {error}", field="certificate") from None
    return context


def is_exposed(host: str, tls: Tls | None) -> bool:
    """Return True if traffic to `host` is neither encrypted nor local; the caller then logs PLAINTEXT_WARNING."""
    return tls is None and not _is_loopback(host)


def listening_address(description: str) -> str:
    """Return the address at which a Twisted server endpoint listens, or an empty string for all addresses."""
    if description.startswith("unix:"):
        return "localhost"
    found = _INTERFACE.search(description)
    return re.sub(r"\\(.)", r"\1", found[1]) if found else ""


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
