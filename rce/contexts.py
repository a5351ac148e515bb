"""The platforms that this user has signed in to: one API key each, in a file that only this user may read.

A command takes its platform from `--url` (or RCE_URL), else from a context: that of `--context` (or RCE_CONTEXT), else
the current one. At an entry named by its address, RCE_KEY, or RCE_PASSWORD with `--user` (or RCE_USER), say who asks,
else a context of this address.
"""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec import Struct

from rce.errors import InvalidRequest, NotFound, Unauthorized

SIGN_IN = "sign in with `rce login URL`, or name the entry with --url and set RCE_KEY or RCE_PASSWORD"


class Access(NamedTuple):
    """The entry of a platform, and the credentials to use there: an API key, or a user with a password."""

    url: str
    user: str  # empty: the key knows
    password: str | None
    key: str | None


class Context(Struct, frozen=True, omit_defaults=True):
    """A platform that was signed in to. `id` names the key at the platform, `expires` is in seconds since 1970."""

    url: str
    user: str
    key: str
    id: str
    expires: float | None = None


class Contexts(Struct):
    """All of them by name; `current` is used unless another is named."""

    current: str = ""
    contexts: dict[str, Context] = {}

    def named(self, name: str) -> Context:
        """NotFound."""
        if name not in self.contexts:
            known = ", ".join(self.contexts) or "none"
            raise NotFound(f"there is no context {name!r} (there is {known}): {SIGN_IN}", field="context")
        return self.contexts[name]


def place() -> Path:
    base = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(base).expanduser() / "rce" / "contexts.json"


def load() -> Contexts:
    """InvalidRequest if the file is not one of ours."""
    path = place()
    try:
        return msgspec.json.decode(path.read_bytes(), type=Contexts)
    except FileNotFoundError:
        return Contexts()
    except (OSError, msgspec.DecodeError) as error:
        raise InvalidRequest(f"{path} cannot be read: {error}; mend it or remove it and sign in again") from None


def save(contexts: Contexts) -> None:
    """Written beside and moved into place, so that it is there whole and was never readable by others."""
    path = place()
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(msgspec.json.format(msgspec.json.encode(contexts)))
    beside.replace(path)


def access(url: str = "", user: str = "", context: str = "") -> Access:
    """Where to go and as whom, for what a command line says. Unauthorized, NotFound."""
    url = url or os.environ.get("RCE_URL", "")
    if url:
        return _at(url, user or os.environ.get("RCE_USER", ""))
    contexts = load()
    name = context or os.environ.get("RCE_CONTEXT", "") or contexts.current
    if not name:
        raise Unauthorized(f"you are not signed in: {SIGN_IN}")
    found = contexts.named(name)
    return Access(found.url, found.user, None, found.key)


def _at(url: str, user: str) -> Access:
    password, key = os.environ.get("RCE_PASSWORD"), os.environ.get("RCE_KEY")
    if user and password:
        return Access(url, user, password, None)
    if key:
        return Access(url, user, None, key)
    if password:
        raise Unauthorized("RCE_PASSWORD is set: say with --user or RCE_USER whose it is", field="user")
    for context in load().contexts.values():
        if context.url.rstrip("/") == url.rstrip("/") and user in ("", context.user):
            return Access(url, context.user, None, context.key)
    raise Unauthorized(f"who asks at {url}? {SIGN_IN}")
