"""Certificates of the platform's authority and of its machines, as OpenSSL sees them."""

from __future__ import annotations

import datetime
import hashlib
import ssl
import time
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import NameOID

from rce.errors import InvalidRequest
from rce.net.certificates import (
    AUTHORITY_DAYS,
    CLOCK_SKEW,
    MACHINE_DAYS,
    Authority,
    certificate_expiry,
    certificate_hosts,
    fingerprint,
    generate_key,
    key_to_pem,
    signing_request,
)
from rce.net.tls import CA, CERTIFICATE, KEY
from tests.support.certificates import certify

DAY = 24 * 3600


@pytest.fixture(scope="module")
def authority() -> Authority:
    return Authority.make("test")


def handshake(server: Path, client: Path, host: str) -> None:
    """Make a mutual TLS handshake in memory; raises SSLError if one side refuses the other."""
    sides: list[ssl.SSLObject] = []
    pipes = ssl.MemoryBIO(), ssl.MemoryBIO()
    for directory, is_server in ((server, True), (client, False)):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if is_server else ssl.PROTOCOL_TLS_CLIENT)
        context.verify_mode = ssl.CERT_REQUIRED
        context.load_verify_locations(directory / CA)
        context.load_cert_chain(directory / CERTIFICATE, directory / KEY)
        incoming, outgoing = pipes if is_server else pipes[::-1]
        sides.append(context.wrap_bio(incoming, outgoing, is_server, None if is_server else host))
    waiting = sides[::-1]
    for _ in range(10):
        for side in [*waiting]:
            try:
                side.do_handshake()
                waiting.remove(side)
            except ssl.SSLWantReadError:
                continue
    assert not waiting


@pytest.mark.parametrize("host", ["m1.example.org", "10.0.0.1", "fd00::1"])
def test_machines_trust_each_other(authority: Authority, tmp_path: Path, host: str) -> None:
    server = certify(tmp_path / "server", authority, ["m1.example.org", "10.0.0.1", "fd00::1"])
    handshake(server, certify(tmp_path / "client", authority, ["m2"]), host)


def test_certificate_is_refused_for_other_hosts(authority: Authority, tmp_path: Path) -> None:
    server = certify(tmp_path / "server", authority, ["m1"])
    with pytest.raises(ssl.SSLCertVerificationError, match="m2"):
        handshake(server, certify(tmp_path / "client", authority, ["m3"]), "m2")


def test_machine_of_another_authority_is_refused(authority: Authority, tmp_path: Path) -> None:
    server = certify(tmp_path / "server", authority, ["m1"])
    stranger = certify(tmp_path / "client", Authority.make("test"), ["m2"])
    (stranger / CA).write_text(authority.certificate)
    with pytest.raises(ssl.SSLError):
        handshake(server, stranger, "m1")


def test_machine_cannot_issue_certificates(authority: Authority, tmp_path: Path) -> None:
    machine = certify(tmp_path / "machine", authority, ["m1"])
    forged = certify(tmp_path / "forged", Authority.load(machine / CERTIFICATE, machine / KEY), ["m2"])
    (forged / CERTIFICATE).write_text((forged / CERTIFICATE).read_text() + (machine / CERTIFICATE).read_text())
    (forged / CA).write_text(authority.certificate)
    with pytest.raises(ssl.SSLError):
        handshake(forged, machine, "m2")


def test_authority_is_loaded_with_its_key_only(authority: Authority, tmp_path: Path) -> None:
    certificate, key = tmp_path / "ca.pem", tmp_path / "ca.key"
    certificate.write_text(authority.certificate)
    key.write_text(authority.key)
    loaded = Authority.load(certificate, key)
    assert (loaded.certificate, loaded.key) == (authority.certificate, authority.key)
    key.write_text(Authority.make("other").key)
    with pytest.raises(InvalidRequest, match="is not the key of this certificate"):
        Authority.load(certificate, key)
    key.write_text("nonsense")
    with pytest.raises(InvalidRequest, match=str(certificate)):
        Authority.load(certificate, key)
    key.unlink()
    with pytest.raises(InvalidRequest, match=r"ca\.key"):
        Authority.load(certificate, key)


def test_certificate_has_the_requested_key_but_not_the_requested_name(authority: Authority) -> None:
    key = generate_key()
    issued = x509.load_pem_x509_certificate(authority.issue(signing_request(key, "root"), "m1", ["m1"]).encode())
    assert issued.public_key() == key.public_key()
    assert [name.value for name in issued.subject] == ["m1"]


def test_hosts_are_listed_once_and_in_order(authority: Authority) -> None:
    issued = authority.issue(signing_request(generate_key(), "m1"), "m1", ["m1", "10.0.0.1", "m1", "::1"])
    assert certificate_hosts(issued) == ["m1", "10.0.0.1", "::1"]


def test_long_name_is_truncated_to_the_limit_of_x509(authority: Authority) -> None:
    issued = authority.issue(signing_request(generate_key(), "x" * 100), "m" * 100, ["m1"])
    assert [name.value for name in x509.load_pem_x509_certificate(issued.encode()).subject] == ["m" * 64]


@pytest.mark.parametrize("request_text", ["", "nonsense", "-----BEGIN CERTIFICATE REQUEST-----\nAAAA\n"])
def test_malformed_request_is_refused(authority: Authority, request_text: str) -> None:
    with pytest.raises(InvalidRequest, match="not a certificate signing request") as caught:
        authority.issue(request_text, "m1", ["m1"])
    assert caught.value.field == "request"


def test_request_with_a_broken_signature_is_refused(authority: Authority) -> None:
    request = x509.load_pem_x509_csr(signing_request(generate_key(), "m1").encode())
    damaged = bytearray(request.public_bytes(serialization.Encoding.DER))
    damaged[-1] ^= 1
    pem = ssl.DER_cert_to_PEM_cert(bytes(damaged)).replace("CERTIFICATE", "CERTIFICATE REQUEST")
    with pytest.raises(InvalidRequest, match="signed by its own elliptic curve key"):
        authority.issue(pem, "m1", ["m1"])


def test_request_with_a_key_of_another_kind_is_refused(authority: Authority) -> None:
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "m1")])
    key = rsa.generate_private_key(65537, 2048)
    built = x509.CertificateSigningRequestBuilder().subject_name(name).sign(key, hashes.SHA256())
    with pytest.raises(InvalidRequest, match="elliptic curve"):
        authority.issue(built.public_bytes(serialization.Encoding.PEM).decode(), "m1", ["m1"])


def test_host_that_is_not_ascii_is_refused(authority: Authority) -> None:
    with pytest.raises(InvalidRequest, match="'köln' is not a valid host name"):
        authority.issue(signing_request(generate_key(), "m1"), "m1", ["köln"])


def test_validity_begins_earlier_for_slow_clocks(authority: Authority) -> None:
    issued = authority.issue(signing_request(generate_key(), "m1"), "m1", ["m1"])
    begin = x509.load_pem_x509_certificate(issued.encode()).not_valid_before_utc
    now = datetime.datetime.now(datetime.UTC)
    assert datetime.timedelta(0) <= now - CLOCK_SKEW - begin < datetime.timedelta(minutes=5)
    assert certificate_expiry(issued) == pytest.approx(time.time() + MACHINE_DAYS * DAY, abs=300)
    assert certificate_expiry(authority.certificate) == pytest.approx(time.time() + AUTHORITY_DAYS * DAY, abs=300)


def test_fingerprint_is_the_sha256_of_the_certificate(authority: Authority) -> None:
    der = ssl.PEM_cert_to_DER_cert(authority.certificate)
    assert fingerprint(authority.certificate) == hashlib.sha256(der).hexdigest()
    with pytest.raises(InvalidRequest, match="not a certificate"):
        fingerprint("nonsense")


def test_keys_are_different_and_readable_without_a_password() -> None:
    pems = [key_to_pem(generate_key()) for _ in range(2)]
    assert pems[0] != pems[1]
    for pem in pems:
        key = serialization.load_pem_private_key(pem.encode(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        assert isinstance(key.curve, ec.SECP256R1)


def test_certificate_of_a_machine_that_is_added_again_begins_after_its_removal(authority: Authority) -> None:
    removed = time.time() - 10.5
    issued = authority.issue(signing_request(generate_key(), "beta"), "beta", ["beta"], after=removed)
    valid_from = x509.load_pem_x509_certificate(issued.encode()).not_valid_before_utc.timestamp()
    assert removed < valid_from <= removed + 1
