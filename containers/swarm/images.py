"""Registry from which the nodes of a swarm pull images that only the manager's node has.

It implements as much of the Docker Registry HTTP API V2 as a pull needs. An image is exported from Docker once, as
`docker save` does, into a directory: each layer and the image's *config*, by whose digest Docker knows the image, in a
file named by its SHA-256, and a manifest that names them. Docker itself skips layers that a node already has, and
resumes a transfer that was interrupted.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import os
import re
import tarfile
import tempfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, cast

import docker
from aiohttp import web

from rce.net.tls import CERTIFICATE, KEY, Tls, public_tls_context
from rce.web.requests import header, raw_path
from rce.web.server import Endpoint, listen, logged_in, serve_handler

NAME = "rce"  # the only repository; images in it are requested by digest
USER = "agent"
MANIFEST = "application/vnd.docker.distribution.manifest.v2+json"
CONFIG = "application/vnd.docker.container.image.v1+json"
LAYER = "application/vnd.docker.image.rootfs.diff.tar.gzip"  # Docker also accepts layers without gzip under this type
CHUNK = 1024 * 1024
API_HEADERS = {"Docker-Distribution-Api-Version": "registry/2.0"}
CHALLENGE = {"WWW-Authenticate": 'Basic realm="rce"'}
METHODS = ("GET", "HEAD")
_PATH = re.compile(rf"/v2/{NAME}/(manifests|blobs)/sha256:([0-9a-f]{{64}})")


class _Reader:
    """File object that reads from an iterator of chunks."""

    def __init__(self, chunks: Iterator[bytes]) -> None:
        self._chunks = chunks
        self._rest = b""

    def read(self, size: int) -> bytes:
        while len(self._rest) < size and (chunk := next(self._chunks, b"")):
            self._rest += chunk
        data, self._rest = self._rest[:size], self._rest[size:]
        return data


def export(api: docker.APIClient, image: str, directory: Path) -> str:
    """Export an image from Docker unless that was done before; return the digest of its manifest. Blocks.

    Raises:
        OSError: The files cannot be written.
    """
    known = directory / f"{image.removeprefix('sha256:')}.image"
    if known.exists():
        return known.read_text()
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    blobs: dict[str, str] = {}  # digest of each file in the archive by name; of a link, the name that it leads to
    images: list[dict[str, Any]] = []
    with tarfile.open(fileobj=cast(Any, _Reader(api.get_image(image))), mode="r|") as archive:
        for member in archive:
            if member.issym() or member.islnk():
                target = member.linkname
                blobs[member.name] = os.path.normpath(os.path.join(os.path.dirname(member.name), target))
            elif member.name == "manifest.json":
                images = json.loads(cast(Any, archive.extractfile(member)).read())
            elif member.isfile():
                blobs[member.name] = _store(cast(Any, archive.extractfile(member)), directory)
    (saved,) = images
    manifest = {
        "schemaVersion": 2,
        "mediaType": MANIFEST,
        "config": _descriptor(directory, CONFIG, blobs, saved["Config"]),
        "layers": [_descriptor(directory, LAYER, blobs, name) for name in saved["Layers"]],
    }
    data = json.dumps(manifest).encode()
    digest = hashlib.sha256(data).hexdigest()
    (directory / digest).write_bytes(data)
    known.write_text(f"sha256:{digest}")
    sweep(directory, {f"sha256:{each.stem}" for each in directory.glob("*.image")})  # the archive has further files
    return f"sha256:{digest}"


def _store(file: Any, directory: Path) -> str:
    """Write a file under the name of its SHA-256; return that."""
    digest = hashlib.sha256()
    handle, draft = tempfile.mkstemp(dir=directory, prefix="draft-")
    with os.fdopen(handle, "wb") as copy:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
            copy.write(chunk)
    Path(draft).rename(directory / digest.hexdigest())
    return digest.hexdigest()


def _descriptor(directory: Path, media_type: str, blobs: dict[str, str], name: str) -> dict[str, Any]:
    digest = blobs[name]
    digest = blobs.get(digest, digest)  # a link names another file of the archive
    return {"mediaType": media_type, "size": (directory / digest).stat().st_size, "digest": f"sha256:{digest}"}


def sweep(directory: Path, images: Collection[str]) -> None:
    """Remove all exported images but these, and incomplete exports."""
    kept: set[str] = set()
    for known in directory.glob("*.image"):
        if f"sha256:{known.stem}" in images:
            manifest = known.read_text().removeprefix("sha256:")
            parts = json.loads((directory / manifest).read_bytes())
            digests = [part["digest"].removeprefix("sha256:") for part in (parts["config"], *parts["layers"])]
            kept |= {known.name, manifest, *digests}
    for path in directory.iterdir() if directory.is_dir() else []:
        if path.name not in kept:
            path.unlink()


class ImageRegistry:
    """HTTP server of the images exported to `directory`, for clients that know `secret`.

    The password is derived from the secret of the agents, because every node's Docker gets to see it.
    """

    def __init__(self, directory: Path, secret: str) -> None:
        self.secret = hmac.digest(secret.encode(), b"images", "sha256").hex()
        self.address = ""
        self._directory = directory
        self._runner = serve_handler(self._answer)

    async def listen(self, host: str, port: int, tls: Tls | None) -> int:
        """Listen for HTTP, or HTTPS with `tls`; return the port.

        Docker on the nodes does not verify the certificate, as it does not know the CA; it verifies the digest of what
        it pulls. Without `tls` it tries TLS first all the same, and then plain HTTP.

        Raises:
            Unavailable: The port is in use or cannot be bound.
        """
        context = public_tls_context(str(tls.directory / CERTIFICATE), str(tls.directory / KEY)) if tls else None
        _, bound = await listen(self._runner, Endpoint(host, port, context))
        self.address = f"{host}:{bound}"
        return bound

    async def close(self) -> None:
        """Stop listening and close all connections."""
        await self._runner.cleanup()

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        if not hmac.compare_digest(_password(request), self.secret.encode()):
            return _json_answer(b'{"errors":[]}', 401, CHALLENGE)
        logged_in()
        path = raw_path(request)
        if path == "/v2/":
            return _json_answer(b"{}")
        match = _PATH.fullmatch(path)
        file = self._directory / match[2] if match else None
        if match is None or file is None or not file.is_file():
            return _json_answer(b'{"errors":[]}', 404)
        if request.method not in METHODS:
            return _json_answer(b'{"errors":[]}', 405, {"Allow": ", ".join(METHODS)})
        media_type = MANIFEST if match[1] == "manifests" else "application/octet-stream"
        headers = {"Docker-Content-Digest": f"sha256:{match[2]}", "Content-Type": media_type}
        return web.FileResponse(file, headers=API_HEADERS | headers)


def _password(request: web.BaseRequest) -> bytes:
    """Return the password of a request; empty without a valid one."""
    scheme, _, text = (header(request, "Authorization") or "").partition(" ")
    try:
        credentials = base64.b64decode(text, validate=True)
    except ValueError:
        return b""
    return credentials.partition(b":")[2] if scheme.lower() == "basic" else b""


def _json_answer(body: bytes, status: int = 200, headers: Mapping[str, str] | None = None) -> web.Response:
    headers = {**API_HEADERS, **(headers or {})}
    return web.Response(body=body, status=status, headers=headers, content_type="application/json")
