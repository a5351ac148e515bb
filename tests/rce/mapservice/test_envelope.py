"""SOAP envelopes: what is read, what is refused before it costs much, and answers that are always XML."""

from __future__ import annotations

import hashlib

import pytest
from lxml import etree

from rce.errors import InvalidRequest, RceError, Unauthorized, Unavailable
from rce.mapservice.envelope import (
    MAX_MARKUP,
    NAMESPACE,
    Envelopes,
    NotUnderstood,
    add_texts,
    answer,
    fault,
    qualified_name,
)
from tests.support.soap import NAMES, envelope, username_token

NONE = "0" * 24
STATUS = f"<r:GetStatus><r:job>{NONE}</r:job></r:GetStatus>"


@pytest.fixture(scope="module")
def envelopes() -> Envelopes:
    return Envelopes()


def test_wsdl_has_its_location_and_a_valid_schema(envelopes: Envelopes) -> None:
    assert b"http://here/soap" in envelopes.wsdl("http://here/soap")
    envelopes.check(etree.fromstring(f'<r:GetStatus xmlns:r="{NAMESPACE}"><r:job>{NONE}</r:job></r:GetStatus>'))


def test_body_is_read_without_credentials(envelopes: Envelopes) -> None:
    body, user, secret = envelopes.read(envelope(STATUS).encode())
    assert body.tag == qualified_name("GetStatus")
    assert body.findtext(qualified_name("job")) == NONE
    assert (user, secret) == ("", "")


@pytest.mark.parametrize(
    ("password", "kind", "secret"),
    [
        ("rce_ann", "PasswordText", "rce_ann"),
        ("rce_ann", "", "rce_ann"),
        ("secret", "", hashlib.sha256(b"secret").hexdigest()),
    ],
)
def test_username_token_is_read(envelopes: Envelopes, password: str, kind: str, secret: str) -> None:
    request = envelopes.read(envelope(STATUS, username_token(password, kind)).encode())
    assert (request.user, request.secret) == ("ann", secret)


def test_password_digest_is_refused(envelopes: Envelopes) -> None:
    with pytest.raises(Unauthorized, match="PasswordText"):
        envelopes.read(envelope(STATUS, username_token("x", "PasswordDigest")).encode())


def test_security_header_without_username_token_is_refused(envelopes: Envelopes) -> None:
    empty = username_token("x").partition("<w:UsernameToken>")[0] + "</w:Security>"
    with pytest.raises(Unauthorized, match="UsernameToken"):
        envelopes.read(envelope(STATUS, empty).encode())


@pytest.mark.parametrize(("must", "refused"), [("1", True), ("true", True), ("0", False)])
def test_unknown_header_is_refused_if_it_must_be_understood(envelopes: Envelopes, must: str, refused: bool) -> None:
    text = envelope(STATUS, f'<x:Y xmlns:x="x" s:mustUnderstand="{must}"/>').encode()
    if refused:
        with pytest.raises(NotUnderstood, match="header Y"):
            envelopes.read(text)
    else:
        assert envelopes.read(text).body.tag == qualified_name("GetStatus")


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("no xml", ""),
        ("<a/>", "Envelope"),
        (envelope(""), "Body"),
        (envelope(STATUS + STATUS), "Body"),
        (envelope("<r:DropTables/>"), "DropTables"),
        (envelope("<r:GetStatus/>"), "GetStatus"),
        (envelope("<r:GetStatus><r:job>../x</r:job></r:GetStatus>"), "job"),
    ],
)
def test_request_that_does_not_match_the_schema_names_its_element(envelopes: Envelopes, text: str, field: str) -> None:
    with pytest.raises(InvalidRequest) as wrong:
        envelopes.read(text.encode())
    assert wrong.value.field == field
    assert NAMESPACE not in str(wrong.value)


ENTITY = '<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/hostname">]>'
BOMB = '<!DOCTYPE a [<!ENTITY a "x"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("document_type", "job"), [(ENTITY, "&e;"), (BOMB, "0"), ('<!DOCTYPE a SYSTEM "http://127.0.0.1:1/x.dtd">', "0")]
)
def test_entities_and_document_types_are_refused(envelopes: Envelopes, document_type: str, job: str) -> None:
    text = document_type + envelope(f"<r:GetStatus><r:job>{job}</r:job></r:GetStatus>")
    with pytest.raises(InvalidRequest, match=r"not allowed|not acceptable XML"):
        envelopes.read(text.encode())


def test_deeply_nested_request_is_refused(envelopes: Envelopes) -> None:
    with pytest.raises(InvalidRequest, match="not acceptable XML"):
        envelopes.read(envelope("<r:x>" * 1000).encode())


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (envelope("<a/>" * MAX_MARKUP), "too many"),
        (envelope("<r:GetStatus " + " ".join(f'a{i}=""' for i in range(MAX_MARKUP)) + "/>"), "too many"),
        (envelope("<r:GetStatus><r:job>" + "&amp;" * (MAX_MARKUP + 1) + "</r:job></r:GetStatus>"), "too many"),
        (b'<?xml version="1.0" encoding="utf-7"?>' + b"+ADw-a/+AD4-", "not acceptable XML"),
    ],
    ids=["elements", "attributes", "references", "hidden"],
)
def test_expensive_xml_is_refused_before_parsing(envelopes: Envelopes, text: str | bytes, reason: str) -> None:
    """The credentials are in the request itself, so it is parsed before the client is authenticated."""
    with pytest.raises(InvalidRequest, match=reason):
        envelopes.read(text if isinstance(text, bytes) else text.encode())


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InvalidRequest("wrong", field="job"), "soap:Client"),
        (Unavailable("away"), "soap:Server"),
        (NotUnderstood("the header X is not supported"), "soap:MustUnderstand"),
    ],
)
def test_fault_says_who_is_at_fault(error: RceError, code: str) -> None:
    found = etree.fromstring(fault(error)).find("s:Body/s:Fault", NAMES)
    assert found is not None
    assert found.findtext("faultcode") == code
    assert found.findtext("faultstring") == str(error)
    assert found.findtext("detail/r:Problem/r:code", None, NAMES) == error.info.code
    assert found.findtext("detail/r:Problem/r:field", None, NAMES) == (error.field or None)


@pytest.mark.parametrize("character", ["\0", "\x1b", "\r", "\udc80", "\ufffe"], ids=ascii)
def test_fault_leaves_out_what_xml_cannot_contain(character: str) -> None:
    """A message may quote a recording, for instance the names of its topics."""
    found = etree.fromstring(fault(InvalidRequest(f"no topic /a{character}b")))
    assert found.findtext(".//faultstring") == "no topic /ab"
    assert found.findtext(".//r:message", None, NAMES) == "no topic /ab"


def test_texts_are_added_except_none() -> None:
    parent = etree.Element("a")
    add_texts(parent, scans=0, stage="", total=None, name="ä\n😀")
    texts = [(etree.QName(each).localname, each.text or "") for each in parent]
    assert texts == [("scans", "0"), ("stage", ""), ("name", "ä\n😀")]


def test_answer_is_the_only_element_of_the_body() -> None:
    body = etree.fromstring(answer(etree.Element(qualified_name("GetStatusResponse")))).find("s:Body", NAMES)
    assert body is not None
    assert [each.tag for each in body] == [qualified_name("GetStatusResponse")]
