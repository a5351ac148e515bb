"""A machine's certificate: `python -P -m provisioning.identity make|join`, in the installed environment.

On the Master's machine `make` makes a CA, unless it exists, and a certificate. Elsewhere `join` requests a certificate
from the Master of a join code, and prints the Master's answer as JSON.
"""

from __future__ import annotations

import argparse
import http.client
import os
import ssl
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

import msgspec
from cryptography.hazmat.primitives.asymmetric import ec

from rce import __version__
from rce.api.joining import JoinCode, JoinRequest, Membership, parse_join_code
from rce.errors import ErrorInfo, InternalError, InvalidRequest, RceError, Unavailable
from rce.net.certificates import (
    Authority,
    certificate_hosts,
    fingerprint,
    generate_key,
    key_to_pem,
    load_key,
    signing_request,
)
from rce.net.tls import CA, CERTIFICATE, KEY

JOINING_KEY = "joining.pem"  # the key while the machine has no certificate for it
TIMEOUT = 20.0  # seconds
T = TypeVar("T")


def make(directory: Path, authority_key: Path, name: str, hosts: Sequence[str]) -> str:
    """Make the CA and this machine's certificate for `hosts`, unless they exist, and return a remark about it."""
    if not authority_key.exists():
        authority = Authority.make(f"RCE at {name}")
        write(authority_key, authority.key, private=True)
        write(directory / CA, authority.certificate)
    authority = Authority.load(directory / CA, authority_key)
    if (directory / CERTIFICATE).exists() and set(hosts) <= set(
        certificate_hosts((directory / CERTIFICATE).read_text())
    ):
        return "kept"
    key = generate_key()
    write(directory / KEY, key_to_pem(key), private=True)
    write(directory / CERTIFICATE, authority.issue(signing_request(key, name), name, hosts))
    return f"for {', '.join(hosts)}"


def join(directory: Path, code: JoinCode) -> Membership:
    """Get this machine's certificate from the Master of a join code.

    Raises:
        Unavailable: The Master cannot be reached.
        Unauthorized: The invitation is not valid any more.
        InvalidRequest: The server is not the Master that made the code, or the Master refuses this version.
        InternalError: The answer is malformed.
    """
    authority = _authority(code)
    key = _joining_key(directory / JOINING_KEY)
    join_request = JoinRequest(code.invitation, signing_request(key, code.invitation.name), __version__)
    trust = ssl.create_default_context(cadata=authority)
    status, body = _ask(code.url, trust, "POST", "machines", msgspec.json.encode(join_request))
    if status != http.client.OK:
        raise RceError.from_info(_decode(body, ErrorInfo))
    membership = _decode(body, Membership)
    write(directory / KEY, key_to_pem(key), private=True)
    write(directory / CERTIFICATE, membership.certificate)
    write(directory / CA, authority)
    (directory / JOINING_KEY).unlink()
    return membership


def _joining_key(file: Path) -> ec.EllipticCurvePrivateKey:
    """Return the key of an attempt to join that did not end, else a new one.

    If the answer to that attempt was lost, the invitation is good for its key only.
    """
    if file.exists():
        return load_key(file.read_text())
    key = generate_key()
    write(file, key_to_pem(key), private=True)
    return key


def _authority(code: JoinCode) -> str:
    """Get the CA's certificate, over an unverified connection. The fingerprint in the join code authenticates it."""
    unverified = ssl.create_default_context()
    unverified.check_hostname = False
    unverified.verify_mode = ssl.CERT_NONE
    status, body = _ask(code.url, unverified, "GET", "authority")
    certificate = body.decode(errors="replace")
    if status != http.client.OK or fingerprint(certificate) != code.authority:
        raise InvalidRequest(
            f"the server at {code.url} is not the Master that made this join code: nothing was sent to it"
        )
    return certificate


def _ask(url: str, trust: ssl.SSLContext, method: str, path: str, body: bytes | None = None) -> tuple[int, bytes]:
    parts = urlsplit(url)
    connection = http.client.HTTPSConnection(parts.hostname or "", parts.port, timeout=TIMEOUT, context=trust)
    try:
        connection.request(method, parts.path + path, body)
        answer = connection.getresponse()
        return answer.status, answer.read()
    except (OSError, http.client.HTTPException) as error:
        raise Unavailable(
            f"the Master at {url} cannot be reached: {error or type(error).__name__}; "
            "check that its port is open for this machine"
        ) from None
    finally:
        connection.close()


def _decode(body: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(body, type=kind)
    except msgspec.DecodeError as error:
        raise InternalError(f"the answer of the Master is malformed: {error}") from None


def write(path: Path, text: str, private: bool = False) -> None:
    """Write a file atomically. A private file is readable to its owner only; `install` gives its group access."""
    handle, draft = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
    with os.fdopen(handle, "w") as file:
        file.write(text)
        os.fchmod(file.fileno(), 0o600 if private else 0o644)
    os.rename(draft, path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program and return its exit status."""
    whole = argparse.ArgumentParser(prog="python -m provisioning.identity", description=__doc__)
    whole.add_argument("--directory", type=Path, required=True)
    commands = whole.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make")
    making.add_argument("--authority-key", type=Path, required=True)
    making.add_argument("name")
    making.add_argument("host", nargs="+")
    commands.add_parser("join", help="the join code is read from standard input")
    words = whole.parse_args(arguments)
    try:
        if words.command == "make":
            print(make(words.directory, words.authority_key, words.name, words.host))
        else:
            print(msgspec.json.encode(join(words.directory, parse_join_code(sys.stdin.read()))).decode())
    except (RceError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
