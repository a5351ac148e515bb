"""TLS of control connections: Twisted's, which needs pyOpenSSL. Imported only where TLS is wanted.

An environment's own endpoint reaches the Master through its machine's relay, so that images need not have it.
"""

from __future__ import annotations

import re
from typing import Any

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

from rce.tls import CA, CERTIFICATE, KEY, Tls

_PEM = re.compile(rb"-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)


class _Files:
    """The files of `tls`, which could be used before, as Twisted takes them."""

    def __init__(self, tls: Tls) -> None:
        authorities = _PEM.findall((tls.directory / CA).read_bytes())
        own, *chain = _PEM.findall((tls.directory / CERTIFICATE).read_bytes())
        self.trust = trustRootFromCertificates([Certificate.loadPEM(each) for each in authorities])
        self.own = PrivateCertificate.loadPEM(own + b"\n" + (tls.directory / KEY).read_bytes())
        self.chain = [Certificate.loadPEM(each).original for each in chain]


def taking(tls: Tls, factory: Any) -> TLSMemoryBIOFactory:
    """A factory whose connections are TLS, from machines of the platform only."""
    files = _Files(tls)
    options = CertificateOptions(
        privateKey=files.own.privateKey.original,
        certificate=files.own.original,
        extraCertChain=files.chain,
        trustRoot=files.trust,
        raiseMinimumTo=TLSVersion.TLSv1_2,
    )
    return TLSMemoryBIOFactory(options, False, factory)  # type: ignore[arg-type]  # mypy does not know zope's interfaces


def dialling(tls: Tls, host: str, endpoint: IStreamClientEndpoint) -> IStreamClientEndpoint:
    """The endpoint with TLS over it, to the machine of the platform that is `host`."""
    files = _Files(tls)
    more = {"extraCertChain": files.chain, "raiseMinimumTo": TLSVersion.TLSv1_2}
    return endpoints.wrapClientTLS(
        optionsForClientTLS(host, files.trust, files.own, extraCertificateOptions=more), endpoint
    )
