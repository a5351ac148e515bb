"""The platform's own certificates: an authority made on the spot, which machines trust, and certificates of machines.

Between machines nobody but this authority is trusted, so no public one can let a stranger in. Each machine makes its
own key, which never leaves it. Elliptic curve P-256 throughout: every TLS library has it.
"""

from __future__ import annotations

import datetime
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
MACHINE_DAYS = 825  # the longest that common TLS libraries accept
SKEW = datetime.timedelta(hours=1)  # a machine's clock may be behind by this
COMMON_NAME_LENGTH = 64  # X.520's bound


class Authority:
    """Signs machines' certificates."""

    def __init__(self, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
        self._certificate = certificate
        self._key = key

    @classmethod
    def make(cls, name: str) -> Authority:
        key = new_key()
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
        """InvalidRequest if the files are not those of an authority."""
        try:
            loaded = serialization.load_pem_private_key(key.read_bytes(), None)
            own = x509.load_pem_x509_certificate(certificate.read_bytes())
        except (OSError, ValueError) as error:
            raise InvalidRequest(f"certificate authority {certificate}: {error}") from None
        if not isinstance(loaded, ec.EllipticCurvePrivateKey) or own.public_key() != loaded.public_key():
            raise InvalidRequest(f"certificate authority {certificate}: {key} is not its key")
        return cls(own, loaded)

    @property
    def certificate(self) -> str:
        return _pem(self._certificate)

    @property
    def key(self) -> str:
        return key_text(self._key)

    def issue(self, request: str, name: str, hosts: Sequence[str]) -> str:
        """A certificate for the key that made `request`, valid for `hosts`, names or addresses.

        What else the request asks for is not granted: who asks is a machine that does not yet belong here.
        """
        try:
            asked = x509.load_pem_x509_csr(request.encode())
            good = asked.is_signature_valid
            public = asked.public_key()
        except (ValueError, InvalidSignature) as error:
            raise InvalidRequest(f"this is no certificate request: {error}", field="request") from None
        if not good or not isinstance(public, ec.EllipticCurvePublicKey):
            raise InvalidRequest("a certificate request must be signed by its own elliptic curve key", field="request")
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        names = x509.SubjectAlternativeName([_host(host) for host in dict.fromkeys(hosts)])
        certificate = (
            _builder(_name(name), self._certificate.subject, public, MACHINE_DAYS)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(names, critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        return _pem(certificate)


def new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def key_text(key: ec.EllipticCurvePrivateKey) -> str:
    """As PEM, not encrypted: a service reads it at night too."""
    plain = serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain).decode()


def request(key: ec.EllipticCurvePrivateKey, name: str) -> str:
    """A certificate request as PEM: proof that whoever asks has the key."""
    built = x509.CertificateSigningRequestBuilder().subject_name(_name(name)).sign(key, hashes.SHA256())
    return built.public_bytes(serialization.Encoding.PEM).decode()


def fingerprint(certificate: str) -> str:
    """SHA-256 of a PEM certificate, in hexadecimal. InvalidRequest."""
    try:
        return x509.load_pem_x509_certificate(certificate.encode()).fingerprint(hashes.SHA256()).hex()
    except ValueError as error:
        raise InvalidRequest(f"this is no certificate: {error}") from None


def hosts_of(certificate: str) -> list[str]:
    """The names and addresses that a PEM certificate is for."""
    names = x509.load_pem_x509_certificate(certificate.encode()).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    return [str(name.value) for name in names.value]


def end_of(certificate: str) -> float:
    """When a PEM certificate ends, in seconds since 1970."""
    return x509.load_pem_x509_certificate(certificate.encode()).not_valid_after_utc.timestamp()


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - SKEW)
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(certificates: bool) -> x509.KeyUsage:
    """What a key may sign: certificates, or handshakes."""
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
        raise InvalidRequest(f"{host!r} is no name of a machine: {error}") from None


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()
