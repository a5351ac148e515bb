"""Registry from which the nodes of a swarm pull images that only the manager's node has.

It implements as much of the Docker Registry HTTP API V2 as a pull needs. An image is exported from Docker once, as
`docker save` does, into a directory: each layer and the image's *config*, by whose digest Docker knows the image, in a
file named by its SHA-256, and a manifest that names them. Docker itself skips layers that a node already has, and
resumes a transfer that was interrupted.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
import os
import re
import tarfile
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, cast

import docker
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort
from twisted.protocols.policies import ProtocolWrapper, WrappingFactory
from twisted.web.http import NOT_FOUND, UNAUTHORIZED
from twisted.web.resource import Resource
from twisted.web.server import Request, Site
from twisted.web.static import File

from containers.ports import close_port
from rce.net.tls import CERTIFICATE, KEY, Tls

NAME = "rce"  # the only repository; images in it are requested by digest
USER = "agent"
MANIFEST = "application/vnd.docker.distribution.manifest.v2+json"
CONFIG = "application/vnd.docker.container.image.v1+json"
LAYER = "application/vnd.docker.image.rootfs.diff.tar.gzip"  # Docker also accepts layers without gzip under this type
CHUNK = 1024 * 1024
TLS_HANDSHAKE = b"\x16"  # first byte of a TLS handshake record
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


class _TlsRejecter(ProtocolWrapper):
    """Closes a connection that begins with a TLS handshake.

    Docker tries TLS first, and would wait ten seconds for an answer before it tries plain HTTP.
    """

    def dataReceived(self, data: bytes) -> None:
        """Pass data on unless it is a TLS handshake."""
        if data.startswith(TLS_HANDSHAKE):
            cast(Any, self.transport).abortConnection()
        else:
            super().dataReceived(data)  # type: ignore[no-untyped-call]


class ImageRegistry(Resource):
    """HTTP resource that serves the images exported to `directory` to clients that know `secret`.

    The password is derived from the secret of the agents, because every node's Docker gets to see it.
    """

    isLeaf = True

    def __init__(self, directory: Path, secret: str) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.secret = hmac.digest(secret.encode(), b"images", "sha256").hex()
        self.address = ""
        self._directory = directory
        self._port: IListeningPort | None = None

    async def listen(self, reactor: ReactorBase, host: str, port: int, tls: Tls | None) -> int:
        """Listen for HTTP, or HTTPS with `tls`; return the port.

        Docker on the nodes does not verify the certificate, as it does not know the CA; it verifies the digest of what
        it pulls.
        """
        description = f"tcp:{port}:interface={host}"
        if tls is not None:
            files = [endpoints.quoteStringArgument(str(tls.directory / name)) for name in (KEY, CERTIFICATE)]
            description = f"ssl:{port}:interface={host}:privateKey={files[0]}:certKey={files[1]}"
        endpoint = endpoints.serverFromString(reactor, description)
        factory = WrappingFactory(Site(self))
        factory.protocol = _TlsRejecter
        self._port = await endpoint.listen(factory).asFuture(asyncio.get_running_loop())
        bound = int(self._port.getHost().port)  # type: ignore[misc]  # zope declares it without self
        self.address = f"{host}:{bound}"
        return bound

    async def close(self) -> None:
        """Stop listening."""
        if self._port is not None:
            await close_port(self._port)
            self._port = None

    def render(self, request: Request) -> Any:
        """Answer a request."""
        request.setHeader("Docker-Distribution-Api-Version", "registry/2.0")
        if not hmac.compare_digest(request.getPassword(), self.secret.encode()):
            request.setHeader("WWW-Authenticate", 'Basic realm="rce"')
            return _empty_answer(request, UNAUTHORIZED)
        path = request.path.decode()
        if path == "/v2/":
            return b"{}"
        match = _PATH.fullmatch(path)
        file = self._directory / match[2] if match else None
        if match is None or file is None or not file.is_file():
            return _empty_answer(request, NOT_FOUND)
        request.setHeader("Docker-Content-Digest", f"sha256:{match[2]}")
        media_type = MANIFEST if match[1] == "manifests" else "application/octet-stream"
        return File(str(file), defaultType=media_type).render(request)


def _empty_answer(request: Request, code: int) -> bytes:
    request.setResponseCode(code)
    return b'{"errors":[]}'
