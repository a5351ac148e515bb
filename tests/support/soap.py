"""SOAP requests as text, for requests that client libraries would not send."""

from __future__ import annotations

from rce.mapservice.envelope import NAMESPACE, SOAP, WSSE

NAMES = {"s": SOAP, "r": NAMESPACE}


def envelope(body: str, header: str = "") -> str:
    """Return an envelope; in both parts `s` is the prefix of SOAP and `r` that of RoboWS."""
    inside = f"<s:Header>{header}</s:Header><s:Body>{body}</s:Body>"
    return f'<s:Envelope xmlns:s="{SOAP}" xmlns:r="{NAMESPACE}">{inside}</s:Envelope>'


def username_token(password: str, kind: str = "") -> str:
    """Return the security header of user ann; `kind` is the last part of the password's type."""
    kind = f' Type="x#{kind}"' if kind else ""
    return (
        f'<w:Security xmlns:w="{WSSE}" s:mustUnderstand="1"><w:UsernameToken><w:Username>ann</w:Username>'
        f"<w:Password{kind}>{password}</w:Password></w:UsernameToken></w:Security>"
    )
