"""A machine's certificate: `python -P -m provisioning.identity make|join`, in the installed environment.

`make` is for the Master's machine: the authority, unless it is there, and a certificate of its own. `join` asks the
Master of a join code for one, and prints what else it gave as JSON.
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

from rce import __version__
from rce.certificates import Authority, fingerprint, hosts_of, key_text, new_key, request
from rce.errors import ErrorInfo, InternalError, InvalidRequest, RceError, Unavailable
from rce.joining import Application, JoinCode, Membership, parse
from rce.tls import CA, CERTIFICATE, KEY

TIMEOUT = 20.0  # seconds
T = TypeVar("T")


def make(directory: Path, authority_key: Path, name: str, hosts: Sequence[str]) -> str:
    """The authority and this machine's certificate for `hosts`; what is there already stays. What was made."""
    if not authority_key.exists():
        authority = Authority.make(f"RCE at {name}")
        write(authority_key, authority.key, private=True)
        write(directory / CA, authority.certificate)
    authority = Authority.load(directory / CA, authority_key)
    if (directory / CERTIFICATE).exists() and set(hosts) <= set(hosts_of((directory / CERTIFICATE).read_text())):
        return "kept"
    key = new_key()
    write(directory / KEY, key_text(key), private=True)
    write(directory / CERTIFICATE, authority.issue(request(key, name), name, hosts))
    return f"for {', '.join(hosts)}"


def join(directory: Path, code: JoinCode) -> Membership:
    """Get this machine's certificate from the Master that the code names. Unavailable, Unauthorized, InvalidRequest."""
    authority = _authority(code)
    key = new_key()
    application = Application(code.invitation, request(key, code.invitation.name), __version__)
    trust = ssl.create_default_context(cadata=authority)
    status, body = _ask(code.url, trust, "POST", "machines", msgspec.json.encode(application))
    if status != http.client.OK:
        raise RceError.from_info(_decode(body, ErrorInfo))
    membership = _decode(body, Membership)
    write(directory / KEY, key_text(key), private=True)
    write(directory / CERTIFICATE, membership.certificate)
    write(directory / CA, authority)
    return membership


def _authority(code: JoinCode) -> str:
    """The authority's certificate. Whoever gives it: it is known by the fingerprint in the code."""
    stranger = ssl.create_default_context()
    stranger.check_hostname = False
    stranger.verify_mode = ssl.CERT_NONE
    status, body = _ask(code.url, stranger, "GET", "authority")
    certificate = body.decode(errors="replace")
    if status != http.client.OK or fingerprint(certificate) != code.authority:
        raise InvalidRequest(
            f"whoever answers at {code.url} is not the Master that made this join code: nothing was sent to it"
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
            f"the Master at {url} cannot be reached from here: {error or type(error).__name__}; "
            "is its port open for this machine?"
        ) from None
    finally:
        connection.close()


def _decode(body: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(body, type=kind)
    except msgspec.DecodeError as error:
        raise InternalError(f"the Master gave an answer that is none: {error}") from None


def write(path: Path, text: str, private: bool = False) -> None:
    """All of it or nothing; a private file is never readable by others, its group is given access by who installs."""
    handle, draft = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
    with os.fdopen(handle, "w") as file:
        file.write(text)
        os.fchmod(file.fileno(), 0o600 if private else 0o644)
    os.rename(draft, path)


def main(arguments: Sequence[str] | None = None) -> int:
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
            print(msgspec.json.encode(join(words.directory, parse(sys.stdin.read()))).decode())
    except (RceError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
