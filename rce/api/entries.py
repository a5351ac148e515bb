"""URLs of the entries of a platform: one, or those of several Masters, of which one leads."""

from __future__ import annotations

from urllib.parse import urlsplit

from rce.errors import InvalidRequest


def entries(urls: str) -> list[str]:
    """Return the URLs in a text that separates them by commas.

    Raises:
        InvalidRequest: There is none, or one is malformed, or not http or https.
    """
    found = [url.strip() for url in urls.split(",") if url.strip()]
    for url in found or [urls]:
        try:
            parts = urlsplit(url)
            has_address = bool(parts.hostname) and parts.port != 0
        except ValueError:
            parts, has_address = None, False
        if parts is not None and parts.scheme not in ("http", "https"):
            raise InvalidRequest(f"url {url!r} must begin with http:// or https://", field="url")
        if not has_address:
            raise InvalidRequest(f"url {url!r} has no valid host or port: write http://HOST:PORT/", field="url")
    return found
