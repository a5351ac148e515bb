"""SOAP 1.1 envelopes: read with care, validated against the schema of the WSDL, answered, refused."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

from lxml import etree

from rce.errors import InvalidRequest, RceError, Unauthorized
from rce.mapservice.access import KEY_PREFIX
from rce.mapservice.problems import status_of

OWN = "urn:rce:robows:1"
SOAP = "http://schemas.xmlsoap.org/soap/envelope/"
WSDL_SOAP = "http://schemas.xmlsoap.org/wsdl/soap/"
WSSE = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-wssecurity-secext-1.0.xsd"
SCHEMA = "http://www.w3.org/2001/XMLSchema"
CLEAR = "#PasswordText"
MARKUP_MOST = 4000  # tags, attributes and references, each: a large request is one long text


class NotUnderstood(InvalidRequest):
    """A header block that must be understood, and is not."""


class Request(NamedTuple):
    """What is asked for, and the user and secret of a UsernameToken if there is one."""

    body: etree._Element
    user: str
    secret: str


def own(name: str) -> str:
    return f"{{{OWN}}}{name}"


class Envelopes:
    """The WSDL and what follows from it."""

    def __init__(self) -> None:
        self._wsdl = _parse(Path(__file__).with_name("robows.wsdl").read_bytes())
        self._schema = etree.XMLSchema(self._wsdl.find(f".//{{{SCHEMA}}}schema"))

    def wsdl(self, location: str) -> bytes:
        """The WSDL of the service at this address."""
        for address in self._wsdl.iter(f"{{{WSDL_SOAP}}}address"):
            address.set("location", location)
        return bytes(etree.tostring(self._wsdl, xml_declaration=True, encoding="UTF-8"))

    def read(self, data: bytes) -> Request:
        """InvalidRequest for what is no envelope or not as the schema says, Unauthorized for a token of no use.

        Nobody knows yet who asks: what would cost much to parse is refused by a look at its bytes.
        """
        for mark in (b"<", b"=", b"&"):
            if data.count(mark) > MARKUP_MOST:
                raise InvalidRequest(f"a request with more than {MARKUP_MOST} {mark.decode()!r} is not taken here")
        envelope = _parse(data)
        if envelope.tag != f"{{{SOAP}}}Envelope":
            raise InvalidRequest("this is not an envelope of SOAP 1.1", field="Envelope")
        user, secret = _headers(envelope.find(f"{{{SOAP}}}Header"))
        parts = list(envelope.iterfind(f"{{{SOAP}}}Body/*"))
        if len(parts) != 1:
            raise InvalidRequest(f"the Body must have one element, and has {len(parts)}", field="Body")
        self.check(parts[0])
        return Request(parts[0], user, secret)

    def check(self, body: etree._Element) -> None:
        """InvalidRequest if the schema does not allow this."""
        if self._schema.validate(body):
            return
        first = next(iter(self._schema.error_log))
        field = first.path.rpartition("/")[2].rpartition(":")[2] if first.path else ""
        raise InvalidRequest(f"line {first.line}: {first.message[:300]}".replace(f"{{{OWN}}}", ""), field=field[:100])


def answer(body: etree._Element) -> bytes:
    envelope = etree.Element(f"{{{SOAP}}}Envelope", nsmap={"soap": SOAP, "tns": OWN})
    etree.SubElement(envelope, f"{{{SOAP}}}Body").append(body)
    return bytes(etree.tostring(envelope, xml_declaration=True, encoding="UTF-8"))


def fault(error: RceError) -> bytes:
    """`soap:Client` where the request is at fault, `soap:Server` where sending it again may help."""
    kind = "MustUnderstand" if isinstance(error, NotUnderstood) else "Client" if status_of(error) < 500 else "Server"
    body = etree.Element(f"{{{SOAP}}}Fault", nsmap={"soap": SOAP})
    etree.SubElement(body, "faultcode").text = f"soap:{kind}"
    etree.SubElement(body, "faultstring").text = str(error)
    problem = etree.SubElement(etree.SubElement(body, "detail"), own("Problem"), nsmap={"tns": OWN})
    texts(problem, code=error.info.code, message=error.info.message, field=error.info.field or None)
    return answer(body)


def texts(parent: etree._Element, **values: object) -> None:
    """Child elements with these texts; None leaves one out."""
    for name, value in values.items():
        if value is not None:
            etree.SubElement(parent, own(name)).text = "".join(c for c in str(value) if c >= " " or c in "\n\t")


def _parse(data: bytes) -> etree._Element:
    """No entities, no DTD, nothing fetched, nothing huge (libxml2: 10 MB of text, 256 levels); UTF-8 alone."""
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
        raise InvalidRequest(f"this is not XML that is taken here: {error}") from None
    if root.getroottree().docinfo.doctype:
        raise InvalidRequest("a document type is not taken here")
    return root


def _headers(header: etree._Element | None) -> tuple[str, str]:
    user = secret = ""
    for block in header if header is not None else ():
        if block.tag == f"{{{WSSE}}}Security":
            user, secret = _token(block.find(f"{{{WSSE}}}UsernameToken"))
        elif block.get(f"{{{SOAP}}}mustUnderstand") in ("1", "true"):
            raise NotUnderstood(f"the header {etree.QName(block).localname} is not understood here")
    return user, secret


def _token(token: etree._Element | None) -> tuple[str, str]:
    if token is None:
        raise Unauthorized("of WS-Security the UsernameToken is understood here")
    password = token.find(f"{{{WSSE}}}Password")
    if password is None or not password.get("Type", CLEAR).endswith(CLEAR):
        raise Unauthorized("the UsernameToken must have its password as PasswordText: a digest of it cannot be checked")
    text = password.text or ""
    secret = text if text.startswith(KEY_PREFIX) else hashlib.sha256(text.encode()).hexdigest()
    return token.findtext(f"{{{WSSE}}}Username", ""), secret
