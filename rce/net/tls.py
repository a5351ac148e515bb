"""Mutual TLS between machines, with certificates of the platform's own CA.

The directory of a machine has `ca.pem`, and the machine's `cert.pem` and `key.pem`. The connecting side checks that the
certificate is valid for the name or address that it dialled; the accepting side requires any certificate of the CA.
Data links use the contexts of this module; control connections, which are Twisted's, use `rce.control.tls`.

The common name of a certificate is the name of its machine. After a machine was removed, its certificate is refused
until it expires: the Master tells all processes the times of removals. A machine that is added again under the same
name has a certificate that is valid only from a later time.
"""

from __future__ import annotations

import asyncio
import logging
import re
import ssl
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

from rce.errors import InvalidRequest
from rce.net.loopback import is_loopback

CA, CERTIFICATE, KEY = "ca.pem", "cert.pem", "key.pem"  # the files of a machine's directory

PLAINTEXT_WARNING = (
    "{what} is accepted at {host} without TLS: anybody with access to the network between the machines can read and "
    "change it; give each machine a certificate (setting tls)"
)
_INTERFACE = re.compile(r":interface=((?:[^:\\]|\\.)*)")

log = logging.getLogger(__name__)


class Tls:
    """TLS contexts with the certificates of one machine, which refuse the certificates of removed machines.

    Attributes:
        directory: The directory with the certificates.
        server: Context for accepting connections.
        client: Context for opening connections.
        after_removal: Called after a machine was removed, to close connections that are not watched.

    Raises:
        InvalidRequest: The files cannot be used.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._removed: Mapping[str, float] = {}
        self._reported: set[str] = set()  # removed machines of which the log has a warning
        self._open: set[asyncio.Transport] = set()
        self.after_removal: list[Callable[[], None]] = []
        ca = directory / CA
        try:
            self.server = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=ca)
            self.client = ssl.create_default_context(ssl.Purpose.SERVER_AUTH, cafile=ca)
            self.server.verify_mode = ssl.CERT_REQUIRED
            for context in (self.server, self.client):
                context.minimum_version = ssl.TLSVersion.TLSv1_2
                context.load_cert_chain(directory / CERTIFICATE, directory / KEY)
                context.sslobject_class = _object_class(self)
        except (OSError, ssl.SSLError) as error:
            files = f"{CA}, {CERTIFICATE} and {KEY}"
            raise InvalidRequest(f"tls {directory}: {files} cannot be used: {error}", field="tls") from None

    def set_removed(self, machines: Mapping[str, float]) -> None:
        """Set when machines were removed, in seconds since 1970; close the watched connections to such machines."""
        self._removed = machines
        for transport in self._open:
            if self._is_of_removed(transport.get_extra_info("peercert") or {}):
                transport.abort()
        for close in self.after_removal:
            close()

    def is_removed(self, machine: str, valid_from: float) -> bool:
        """Return whether a certificate with this common name and begin of validity is of a machine that was removed."""
        removed = valid_from <= self._removed.get(machine, -1.0)
        if removed and machine not in self._reported:  # once, because it may try again and again
            self._reported.add(machine)
            log.warning("the certificate of machine %s is refused, because that machine was removed", machine)
        return removed

    def watch(self, transport: asyncio.BaseTransport) -> None:
        """Close a connection when the machine of its peer is removed; connections without TLS are ignored."""
        self._open = {each for each in self._open if not each.is_closing()}  # uvloop's have no weak references
        if transport.get_extra_info("peercert"):
            self._open.add(cast(asyncio.Transport, transport))

    def _is_of_removed(self, certificate: Mapping[str, Any]) -> bool:
        """Judge a certificate in the form of `ssl.SSLSocket.getpeercert`."""
        names = [value for part in certificate.get("subject", ()) for key, value in part if key == "commonName"]
        return any(self.is_removed(name, ssl.cert_time_to_seconds(certificate["notBefore"])) for name in names)


def _object_class(tls: Tls) -> type[ssl.SSLObject]:
    """Return the class for the connections of a context. asyncio creates its connections from it."""

    class Checked(ssl.SSLObject):
        def do_handshake(self) -> None:
            super().do_handshake()
            # Also after a session was resumed, when OpenSSL does not verify the certificate again.
            if tls._is_of_removed(self.getpeercert() or {}):
                raise ssl.SSLCertVerificationError("the machine of this certificate was removed")

    return Checked


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
    return tls is None and not is_loopback(host)


def listening_address(description: str) -> str:
    """Return the address at which a Twisted server endpoint listens, or an empty string for all addresses."""
    if description.startswith("unix:"):
        return "localhost"
    found = _INTERFACE.search(description)
    return re.sub(r"\\(.)", r"\1", found[1]) if found else ""
