"""Certificates of the platform: its certificate authority (CA), and the certificates of its machines.

Machines trust only the platform's CA when they talk to each other, so a certificate from a public CA does not admit
anybody. Each machine generates its own key, which never leaves it. All keys are on the elliptic curve P-256, which
every TLS library supports.
"""

from __future__ import annotations

import datetime
import hashlib
import ipaddress
from collections.abc import Sequence
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rce.errors import InvalidRequest

AUTHORITY_DAYS = 20 * 365
MACHINE_DAYS = 825  # the longest validity that common TLS libraries accept
CLOCK_SKEW = datetime.timedelta(hours=1)  # how far the clock of a machine may be behind
COMMON_NAME_LENGTH = 64  # the limit of X.520


class Authority:
    """Certificate authority that signs the certificates of machines."""

    def __init__(self, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
        self._certificate = certificate
        self._key = key

    @classmethod
    def make(cls, name: str) -> Authority:
        """Create an authority with a new key and a self-signed certificate."""
        key = generate_key()
        subject = _name(name)
        certificate = (
            _builder(subject, subject, key.public_key(), AUTHORITY_DAYS)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(certificates=True), critical=True)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key()), critical=False)
            .sign(key, hashes.SHA256())
        )
        return cls(certificate, key)

    @classmethod
    def load(cls, certificate: Path, key: Path) -> Authority:
        """Load an authority from PEM files.

        Raises:
            InvalidRequest: The files cannot be read, or do not belong together.
        """
        try:
            loaded = serialization.load_pem_private_key(key.read_bytes(), None)
            own = x509.load_pem_x509_certificate(certificate.read_bytes())
        except (OSError, ValueError) as error:
            raise InvalidRequest(f"certificate authority {certificate}: {error}") from None
        if not isinstance(loaded, ec.EllipticCurvePrivateKey) or own.public_key() != loaded.public_key():
            raise InvalidRequest(f"certificate authority {certificate}: {key} is not the key of this certificate")
        return cls(own, loaded)

    @property
    def certificate(self) -> str:
        """The authority's certificate as PEM."""
        return _pem(self._certificate)

    @property
    def key(self) -> str:
        """The authority's private key as PEM."""
        return key_to_pem(self._key)

    def issue(self, request: str, name: str, hosts: Sequence[str], after: float = 0.0) -> str:
        """Issue a certificate for the key of a signing request.

        The key is all that is used of the request, because its sender is not trusted yet.

        Args:
            request: The signing request as PEM.
            name: Common name of the certificate.
            hosts: Host names and IP addresses for which the certificate is valid.
            after: The certificate is not valid at this time or before, in seconds since 1970. `CLOCK_SKEW` does not
                count here.

        Returns:
            The certificate as PEM.

        Raises:
            InvalidRequest: The request is malformed, or a host is not a valid name.
        """
        public = _requested_key(request)
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        names = x509.SubjectAlternativeName([_host(host) for host in dict.fromkeys(hosts)])
        certificate = (
            _builder(_name(name), self._certificate.subject, public, MACHINE_DAYS, after)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(names, critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        return _pem(certificate)


def generate_key() -> ec.EllipticCurvePrivateKey:
    """Generate a private key on the curve P-256."""
    return ec.generate_private_key(ec.SECP256R1())


def key_to_pem(key: ec.EllipticCurvePrivateKey) -> str:
    """Return a private key as PEM, unencrypted because services must read it without a person present."""
    plain = serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain).decode()


def load_key(pem: str) -> ec.EllipticCurvePrivateKey:
    """Return a private key from PEM.

    Raises:
        InvalidRequest: It is not a key of a machine.
    """
    try:
        key = serialization.load_pem_private_key(pem.encode(), None)
    except ValueError as error:
        raise InvalidRequest(f"not a private key: {error}") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise InvalidRequest("not a private key on an elliptic curve")
    return key


def signing_request(key: ec.EllipticCurvePrivateKey, name: str) -> str:
    """Return a certificate signing request as PEM; its signature proves possession of the key."""
    built = x509.CertificateSigningRequestBuilder().subject_name(_name(name)).sign(key, hashes.SHA256())
    return built.public_bytes(serialization.Encoding.PEM).decode()


def requested_key_digest(request: str) -> str:
    """Return the SHA-256 of the public key of a PEM signing request, in hexadecimal.

    Raises:
        InvalidRequest: The request is malformed.
    """
    form = serialization.PublicFormat.SubjectPublicKeyInfo
    return hashlib.sha256(_requested_key(request).public_bytes(serialization.Encoding.DER, form)).hexdigest()


def _requested_key(request: str) -> ec.EllipticCurvePublicKey:
    try:
        signing_request = x509.load_pem_x509_csr(request.encode())
        good = signing_request.is_signature_valid
        public = signing_request.public_key()
    except (ValueError, InvalidSignature) as error:
        raise InvalidRequest(f"not a certificate signing request: {error}", field="request") from None
    if not good or not isinstance(public, ec.EllipticCurvePublicKey):
        raise InvalidRequest(
            "a certificate signing request must be signed by its own elliptic curve key", field="request"
        )
    return public


def fingerprint(certificate: str) -> str:
    """Return the SHA-256 fingerprint of a PEM certificate, in hexadecimal.

    Raises:
        InvalidRequest: The text is not a certificate.
    """
    try:
        return x509.load_pem_x509_certificate(certificate.encode()).fingerprint(hashes.SHA256()).hex()
    except ValueError as error:
        raise InvalidRequest(f"not a certificate: {error}") from None


def certificate_hosts(certificate: str) -> list[str]:
    """Return the host names and IP addresses for which a PEM certificate is valid."""
    names = x509.load_pem_x509_certificate(certificate.encode()).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    return [str(name.value) for name in names.value]


def certificate_expiry(certificate: str) -> float:
    """Return the time at which a PEM certificate expires, in seconds since 1970."""
    return x509.load_pem_x509_certificate(certificate.encode()).not_valid_after_utc.timestamp()


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int, after: float = 0.0
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    first = datetime.datetime.fromtimestamp(int(after) + 1, datetime.UTC)  # certificates have whole seconds
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(max(now - CLOCK_SKEW, first))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(certificates: bool) -> x509.KeyUsage:
    """Return the key usage of an authority (`certificates`: it signs those) or of a machine (it signs handshakes)."""
    return x509.KeyUsage(
        digital_signature=not certificates,
        key_cert_sign=certificates,
        crl_sign=certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name[:COMMON_NAME_LENGTH])])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise InvalidRequest(f"{host!r} is not a valid host name: {error}") from None


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()
