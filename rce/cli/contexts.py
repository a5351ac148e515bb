"""Contexts: the platforms that this user has signed in to, with an API key each, in a file only they can read.

A command takes its platform from `--url`, else from the context of `--context`, else from RCE_URL, else from the
context of RCE_CONTEXT, else from the current one. For an entry named by its address, the credentials are RCE_KEY, or
RCE_PASSWORD with `--user` (or RCE_USER), else those of a context with this address.
"""

from __future__ import annotations

import argparse
import os
import secrets
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import msgspec
from msgspec import Struct

from rce.api.entries import entries
from rce.cli.arguments import DEV_USER, LOCAL_URL
from rce.errors import MALFORMED, InvalidRequest, NotFound, Unauthorized
from rce.net.loopback import is_loopback

SIGN_IN = "sign in with `rce login URL`, or name the entry with --url and set RCE_KEY or RCE_PASSWORD"


class Access(NamedTuple):
    """Entry of a platform, with the credentials to use there: an API key, or a user with a password."""

    url: str
    user: str  # may be empty with a key, by which the platform knows the user
    password: str | None
    key: str | None


class Context(Struct, frozen=True, omit_defaults=True):
    """A platform that the user has signed in to.

    `id` is the id of the key at the platform; `expires` is in seconds since 1970.
    """

    url: str
    user: str
    key: str
    id: str
    expires: float | None = None


class Contexts(Struct):
    """All contexts by name, and the name of the current one."""

    current: str = ""
    contexts: dict[str, Context] = {}

    def named(self, name: str) -> Context:
        """Return the context of this name.

        Raises:
            NotFound: There is none.
        """
        if name not in self.contexts:
            known = ", ".join(self.contexts) or "none"
            raise NotFound(f"there is no context {name!r} (existing: {known}): {SIGN_IN}", field="context")
        return self.contexts[name]


def contexts_path() -> Path:
    """Return the path of the file."""
    base = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(base).expanduser() / "rce" / "contexts.json"


def load() -> Contexts:
    """Read the file; without one there are no contexts.

    Raises:
        InvalidRequest: The file cannot be read, or has other content.
    """
    path = contexts_path()
    try:
        return msgspec.json.decode(path.read_bytes(), type=Contexts)
    except FileNotFoundError:
        return Contexts()
    except (OSError, *MALFORMED) as error:
        raise InvalidRequest(f"cannot read {path}: {error}; repair it, or remove it and sign in again") from None


def save(contexts: Contexts) -> None:
    """Replace the file atomically; it is readable by its owner only from the beginning."""
    path = contexts_path()
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(msgspec.json.format(msgspec.json.encode(contexts)))
    temporary.replace(path)


def access(url: str = "", user: str = "", context: str = "") -> Access:
    """Return entry and credentials for the options `SIGNED_IN` of a command line.

    Raises:
        Unauthorized: Neither options, environment variables nor a context give credentials.
        NotFound: There is no context of this name.
    """
    if not context:
        url = url or os.environ.get("RCE_URL", "")
    if url:
        return _access_at(url, user or os.environ.get("RCE_USER", ""))
    contexts = load()
    name = context or os.environ.get("RCE_CONTEXT", "") or contexts.current
    if not name:
        others = f"choose a context with `rce context use NAME` ({', '.join(contexts.contexts)}), or "
        raise Unauthorized(f"you are not signed in: {others if contexts.contexts else ''}{SIGN_IN}")
    found = contexts.named(name)
    return Access(found.url, found.user, None, found.key)


def _access_at(url: str, user: str) -> Access:
    password, key = os.environ.get("RCE_PASSWORD"), os.environ.get("RCE_KEY")
    if user and password:
        return Access(url, user, password, None)
    if key:
        return Access(url, user, None, key)
    if password:
        raise Unauthorized("RCE_PASSWORD is set without a user: give --user or set RCE_USER", field="user")
    for context in _contexts_at(url, user):
        return Access(url, context.user, None, context.key)
    raise Unauthorized(f"no credentials {f'of user {user} ' if user else ''}for {url}: {SIGN_IN}")


def _contexts_at(url: str, user: str) -> list[Context]:
    """Return the contexts of a platform, of a user if one is given."""
    found = [each for each in load().contexts.values() if each.url.rstrip("/") == url.rstrip("/")]
    return [each for each in found if user in ("", each.user)]


def running_platform(args: argparse.Namespace) -> Access:
    """Return entry and credentials for the options `RUNNING` or `RUNNING_OR_OWN` of a command line.

    RCE_URL and RCE_USER stand for the options. Without a URL and credentials it is the platform that the user is signed
    in to, else one of development on this machine.

    Raises:
        InvalidRequest: The URL is malformed.
        Unauthorized: There are no credentials for the platform, or a password without a user.
        NotFound: There is no context of this name.
    """
    if context := getattr(args, "context", ""):
        return access(context=context)
    url = args.url or os.environ.get("RCE_URL", "")
    user = args.user or os.environ.get("RCE_USER", "")
    password = args.password or os.environ.get("RCE_PASSWORD")
    key = None if password else os.environ.get("RCE_KEY")
    local = all(is_loopback(urlsplit(each).hostname or "") for each in entries(url or LOCAL_URL))
    if key or (password and (user or local)):
        return Access(url or LOCAL_URL, user or DEV_USER, password, key)
    if not password and user in ("", DEV_USER):
        if not url and (os.environ.get("RCE_CONTEXT") or load().current):
            return access()
        if local and not _contexts_at(url, user):
            return Access(url or LOCAL_URL, DEV_USER, DEV_USER, None)
    return _access_at(url or LOCAL_URL, user)
