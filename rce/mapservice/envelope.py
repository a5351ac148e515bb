"""SOAP 1.1 envelopes: safe parsing, validation against the schema of the WSDL, answers and faults."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import NamedTuple

from lxml import etree

from rce.errors import InvalidRequest, RceError, Unauthorized
from rce.services.authentication import KEY_PREFIX
from rce.web.problems import status_of

NAMESPACE = "urn:rce:robows:1"
SOAP = "http://schemas.xmlsoap.org/soap/envelope/"
WSDL_SOAP = "http://schemas.xmlsoap.org/wsdl/soap/"
WSSE = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-wssecurity-secext-1.0.xsd"
SCHEMA = "http://www.w3.org/2001/XMLSchema"
CLEAR = "#PasswordText"
NOT_XML = re.compile("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
MAX_MARKUP = 4000  # number each of tags, attributes and references; large requests consist of one long text


class NotUnderstood(InvalidRequest):
    """The service does not understand a header block with `mustUnderstand`."""


class Request(NamedTuple):
    """Body of a request, and the user and secret of its UsernameToken, which are empty without one."""

    body: etree._Element
    user: str
    secret: str


def qualified_name(name: str) -> str:
    """Return the name of an element in our own namespace."""
    return f"{{{NAMESPACE}}}{name}"


class Envelopes:
    """Parser and validator of envelopes, after the WSDL."""

    def __init__(self) -> None:
        self._wsdl = _parse(Path(__file__).with_name("robows.wsdl").read_bytes())
        self._schema = etree.XMLSchema(self._wsdl.find(f".//{{{SCHEMA}}}schema"))

    def wsdl(self, location: str) -> bytes:
        """Return the WSDL with `location` as address of the service."""
        for address in self._wsdl.iter(f"{{{WSDL_SOAP}}}address"):
            address.set("location", location)
        return bytes(etree.tostring(self._wsdl, xml_declaration=True, encoding="UTF-8"))

    def read(self, data: bytes) -> Request:
        """Parse and validate an envelope.

        Its sender is not authenticated yet, so requests that would be expensive to parse are refused first, by counting
        bytes.

        Raises:
            InvalidRequest: The data is not an envelope, or does not match the schema.
            Unauthorized: The security header has no usable token.
        """
        for mark in (b"<", b"=", b"&"):
            if data.count(mark) > MAX_MARKUP:
                raise InvalidRequest(f"the request has more than {MAX_MARKUP} {mark.decode()!r}, which is too many")
        envelope = _parse(data)
        if envelope.tag != f"{{{SOAP}}}Envelope":
            raise InvalidRequest("the request is not a SOAP 1.1 envelope", field="Envelope")
        user, secret = _headers(envelope.find(f"{{{SOAP}}}Header"))
        parts = list(envelope.iterfind(f"{{{SOAP}}}Body/*"))
        if len(parts) != 1:
            raise InvalidRequest(f"the Body must have one element, but has {len(parts)}", field="Body")
        self.check(parts[0])
        return Request(parts[0], user, secret)

    def check(self, body: etree._Element) -> None:
        """Validate the body of a request or an answer.

        Raises:
            InvalidRequest: It does not match the schema.
        """
        if self._schema.validate(body):
            return
        first = next(iter(self._schema.error_log))
        field = first.path.rpartition("/")[2].rpartition(":")[2] if first.path else ""
        raise InvalidRequest(
            f"line {first.line}: {first.message[:300]}".replace(f"{{{NAMESPACE}}}", ""), field=field[:100]
        )


def answer(body: etree._Element) -> bytes:
    """Return the envelope of an answer."""
    envelope = etree.Element(f"{{{SOAP}}}Envelope", nsmap={"soap": SOAP, "tns": NAMESPACE})
    etree.SubElement(envelope, f"{{{SOAP}}}Body").append(body)
    return bytes(etree.tostring(envelope, xml_declaration=True, encoding="UTF-8"))


def fault(error: RceError) -> bytes:
    """Return the envelope of a fault: `soap:Client` if the request is wrong, `soap:Server` if a retry may succeed."""
    kind = "MustUnderstand" if isinstance(error, NotUnderstood) else "Client" if status_of(error) < 500 else "Server"
    body = etree.Element(f"{{{SOAP}}}Fault", nsmap={"soap": SOAP})
    etree.SubElement(body, "faultcode").text = f"soap:{kind}"
    etree.SubElement(body, "faultstring").text = _xml_text(error)
    problem = etree.SubElement(etree.SubElement(body, "detail"), qualified_name("Problem"), nsmap={"tns": NAMESPACE})
    add_texts(problem, code=error.info.code, message=error.info.message, field=error.info.field or None)
    return answer(body)


def add_texts(parent: etree._Element, **values: object) -> None:
    """Add child elements with these texts; None adds no element."""
    for name, value in values.items():
        if value is not None:
            etree.SubElement(parent, qualified_name(name)).text = _xml_text(value)


def _xml_text(value: object) -> str:
    """Return a value as text without the characters that XML cannot contain: names in recordings may have any."""
    return NOT_XML.sub("", str(value))


def _parse(data: bytes) -> etree._Element:
    """Parse UTF-8 XML without entities, DTDs and network access, in libxml2's limits (10 MB of text, 256 levels)."""
    parser = etree.XMLParser(
        encoding="utf-8",
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
    )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise InvalidRequest(f"the request is not acceptable XML: {error}") from None
    if root.getroottree().docinfo.doctype:
        raise InvalidRequest("document types are not allowed")
    return root


def _headers(header: etree._Element | None) -> tuple[str, str]:
    user = secret = ""
    for block in header if header is not None else ():
        if block.tag == f"{{{WSSE}}}Security":
            user, secret = _token(block.find(f"{{{WSSE}}}UsernameToken"))
        elif block.get(f"{{{SOAP}}}mustUnderstand") in ("1", "true"):
            raise NotUnderstood(f"the header {etree.QName(block).localname} is not supported")
    return user, secret


def _token(token: etree._Element | None) -> tuple[str, str]:
    if token is None:
        raise Unauthorized("of WS-Security only the UsernameToken is supported")
    password = token.find(f"{{{WSSE}}}Password")
    if password is None or not password.get("Type", CLEAR).endswith(CLEAR):
        raise Unauthorized("the UsernameToken must have its password as PasswordText: a digest cannot be verified")
    text = password.text or ""
    secret = text if text.startswith(KEY_PREFIX) else hashlib.sha256(text.encode()).hexdigest()
    return token.findtext(f"{{{WSSE}}}Username", ""), secret
