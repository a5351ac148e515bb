"""Names of entries, their named graphs and their files."""

from __future__ import annotations

import re

from rce.api.knowledge import KINDS, Kind
from rce.errors import InvalidRequest, NotFound

GRAPHS = "https://rce.invalid/knowledge/"
"""Prefix of the named graphs. The domain never exists (RFC 2606), so the names belong to no other site."""
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")
UID = re.compile(r"[a-z0-9_-]+(\.[a-z0-9._-]*[a-z0-9_-])")


def make_uid(cls: str, name: str) -> str:
    """Return the uid of an entry: class and name in lower case without blanks.

    Raises:
        InvalidRequest: A name consists of blanks or ends in a dot.
    """
    uid = f"{cls}.{name}".lower().replace(" ", "")
    if not UID.fullmatch(uid):
        raise InvalidRequest(
            f"class and id make the uid {uid!r}; neither may be blank, nor the id end in a dot", field="id"
        )
    return uid


def check_kind(kind: str) -> Kind:
    """Return a kind of entries.

    Raises:
        NotFound: There is no such kind.
    """
    for each in KINDS:
        if kind == each:
            return each
    raise NotFound(f"there are no entries of the kind {kind[:40]!r}: the kinds are {', '.join(KINDS)}", field="kind")


def check_file_name(name: str) -> str:
    """Return a name of a file.

    Raises:
        InvalidRequest: It is not safe as the name of a file.
    """
    if not FILE_NAME.fullmatch(name):
        text = f"{name[:60]!r} is not a valid file name: at most 200 letters, digits, '.', '_' and '-'"
        raise InvalidRequest(text, field="file")
    return name


def graph_of(kind: str, uid: str) -> str:
    """Return the IRI of an entry's named graph, which is the base of relative IRIs in it, too."""
    return f"{GRAPHS}{kind}/{uid}"


def local_name(iri: str) -> str:
    """Return the last part of an IRI in lower case."""
    return re.split(r"[#/:]", iri)[-1].lower()
