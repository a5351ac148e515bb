"""URLs of the entries of a platform: one, or those of several Masters, of which one leads."""

from __future__ import annotations

from urllib.parse import urlsplit

from rce.errors import InvalidRequest


def entries(urls: str) -> list[str]:
    """Return the URLs in a text that separates them by commas.

    Raises:
        InvalidRequest: There is none, or one is not http or https.
    """
    found = [url.strip() for url in urls.split(",") if url.strip()]
    for url in found or [urls]:
        if urlsplit(url).scheme not in ("http", "https"):
            raise InvalidRequest(f"url {url!r} must begin with http:// or https://", field="url")
    return found
