"""TLS of control connections, with Twisted's implementation, which needs pyOpenSSL. Imported only if TLS is configured.

Environment images do not have pyOpenSSL: their endpoint reaches the Master through the relay of its machine.
"""

from __future__ import annotations

import re
from typing import Any

from cryptography.x509.oid import NameOID
from OpenSSL.crypto import X509
from OpenSSL.SSL import VERIFY_FAIL_IF_NO_PEER_CERT, VERIFY_PEER, Connection
from twisted.internet import endpoints
from twisted.internet.interfaces import IStreamClientEndpoint
from twisted.internet.ssl import (
    Certificate,
    CertificateOptions,
    PrivateCertificate,
    TLSVersion,
    optionsForClientTLS,
    trustRootFromCertificates,
)
from twisted.protocols.tls import TLSMemoryBIOFactory

from rce.net.tls import CA, CERTIFICATE, KEY, Tls

_PEM = re.compile(rb"-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)


class _Certificates:
    """Certificates of a machine as Twisted's objects. The files are valid, since `Tls` has loaded them."""

    def __init__(self, tls: Tls) -> None:
        authorities = _PEM.findall((tls.directory / CA).read_bytes())
        own, *chain = _PEM.findall((tls.directory / CERTIFICATE).read_bytes())
        self.trust = trustRootFromCertificates([Certificate.loadPEM(each) for each in authorities])
        self.own = PrivateCertificate.loadPEM(own + b"\n" + (tls.directory / KEY).read_bytes())
        self.chain = [Certificate.loadPEM(each).original for each in chain]


def wrap_server_factory(tls: Tls, factory: Any) -> TLSMemoryBIOFactory:
    """Wrap a factory in TLS that admits only machines of the platform.

    A machine that was removed is refused, and its open connections are closed.
    """
    certificates = _Certificates(tls)
    options = CertificateOptions(
        privateKey=certificates.own.privateKey.original,
        certificate=certificates.own.original,
        extraCertChain=certificates.chain,
        trustRoot=certificates.trust,
        raiseMinimumTo=TLSVersion.TLSv1_2,
    )

    def verify(_: Connection, certificate: X509, _error: int, depth: int, good: int) -> bool:
        return bool(good) and (depth > 0 or not _is_removed(tls, certificate))

    # Twisted resumes no sessions, so that each handshake verifies.
    options.getContext().set_verify(VERIFY_PEER | VERIFY_FAIL_IF_NO_PEER_CERT, verify)
    wrapped = TLSMemoryBIOFactory(options, False, factory)  # type: ignore[arg-type]  # mypy does not know zope's interfaces

    def close_removed() -> None:
        for protocol in list(wrapped.protocols):
            certificate = protocol.getPeerCertificate()
            if certificate is not None and _is_removed(tls, certificate):
                protocol.abortConnection()

    tls.after_removal.append(close_removed)
    return wrapped


def _is_removed(tls: Tls, certificate: X509) -> bool:
    decoded = certificate.to_cryptography()
    names = decoded.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    valid_from = decoded.not_valid_before_utc.timestamp()
    return any(tls.is_removed(str(name.value), valid_from) for name in names)


def wrap_client_endpoint(tls: Tls, host: str, endpoint: IStreamClientEndpoint) -> IStreamClientEndpoint:
    """Wrap an endpoint in TLS and verify that the peer is the machine `host` of the platform."""
    certificates = _Certificates(tls)
    more = {"extraCertChain": certificates.chain, "raiseMinimumTo": TLSVersion.TLSv1_2}
    return endpoints.wrapClientTLS(
        optionsForClientTLS(host, certificates.trust, certificates.own, extraCertificateOptions=more), endpoint
    )
