"""Images of the manager's node for the nodes of a swarm that lack them: as much of a Docker registry as a pull needs.

An image is taken out of Docker once, as `docker save` gives it, into `directory`: each layer and the image's own
description (its *config*, by whose digest Docker knows it) in a file named by its SHA-256, and a manifest that names
them. Layers that a node has already are not sent, and what broke off goes on where it was: that is Docker's own doing.
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

from rce.tls import CERTIFICATE, KEY, Tls

NAME = "rce"  # of the one repository; images in it are asked for by digest
USER = "agent"
MANIFEST = "application/vnd.docker.distribution.manifest.v2+json"
CONFIG = "application/vnd.docker.container.image.v1+json"
LAYER = "application/vnd.docker.image.rootfs.diff.tar.gzip"  # Docker takes plain ones under this name too
CHUNK = 1024 * 1024
HANDSHAKE = b"\x16"  # the first byte of TLS
_PATH = re.compile(rf"/v2/{NAME}/(manifests|blobs)/sha256:([0-9a-f]{{64}})")


class _Reader:
    """Chunks as a file to be read once."""

    def __init__(self, chunks: Iterator[bytes]) -> None:
        self._chunks = chunks
        self._rest = b""

    def read(self, size: int) -> bytes:
        while len(self._rest) < size and (chunk := next(self._chunks, b"")):
            self._rest += chunk
        data, self._rest = self._rest[:size], self._rest[size:]
        return data


def export(api: docker.APIClient, image: str, directory: Path) -> str:
    """Take an image out of Docker, unless it was before; returns the digest of its manifest. Blocks; OSError."""
    known = directory / f"{image.removeprefix('sha256:')}.image"
    if known.exists():
        return known.read_text()
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    blobs: dict[str, str] = {}  # digest of each file of the archive, by name
    described: list[dict[str, Any]] = []
    with tarfile.open(fileobj=cast(Any, _Reader(api.get_image(image))), mode="r|") as archive:
        for member in archive:
            if member.issym() or member.islnk():
                target = member.linkname
                blobs[member.name] = os.path.normpath(os.path.join(os.path.dirname(member.name), target))
            elif member.name == "manifest.json":
                described = json.loads(cast(Any, archive.extractfile(member)).read())
            elif member.isfile():
                blobs[member.name] = _store(cast(Any, archive.extractfile(member)), directory)
    (described_image,) = described
    manifest = {
        "schemaVersion": 2,
        "mediaType": MANIFEST,
        "config": _part(directory, CONFIG, blobs, described_image["Config"]),
        "layers": [_part(directory, LAYER, blobs, name) for name in described_image["Layers"]],
    }
    data = json.dumps(manifest).encode()
    digest = hashlib.sha256(data).hexdigest()
    (directory / digest).write_bytes(data)
    known.write_text(f"sha256:{digest}")
    sweep(directory, {f"sha256:{each.stem}" for each in directory.glob("*.image")})  # what else was in the archive
    return f"sha256:{digest}"


def _store(file: Any, directory: Path) -> str:
    digest = hashlib.sha256()
    handle, draft = tempfile.mkstemp(dir=directory, prefix="draft-")
    with os.fdopen(handle, "wb") as copy:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
            copy.write(chunk)
    Path(draft).rename(directory / digest.hexdigest())
    return digest.hexdigest()


def _part(directory: Path, kind: str, blobs: dict[str, str], name: str) -> dict[str, Any]:
    digest = blobs[name]
    digest = blobs.get(digest, digest)  # a link leads to another file of the archive
    return {"mediaType": kind, "size": (directory / digest).stat().st_size, "digest": f"sha256:{digest}"}


def sweep(directory: Path, images: Collection[str]) -> None:
    """Remove all but these images, and what was not finished."""
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


class _Door(ProtocolWrapper):
    """Docker tries TLS first, and would wait for ten seconds where nothing answers that."""

    def dataReceived(self, data: bytes) -> None:
        if data.startswith(HANDSHAKE):
            cast(Any, self.transport).abortConnection()
        else:
            super().dataReceived(data)  # type: ignore[no-untyped-call]


class ImageRegistry(Resource):
    """Serves what was exported to `directory` to those who know the secret."""

    isLeaf = True

    def __init__(self, directory: Path, secret: str) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.secret = hmac.digest(secret.encode(), b"images", "sha256").hex()  # it goes through every node's Docker
        self.address = ""
        self._directory = directory
        self._port: IListeningPort | None = None

    async def listen(self, reactor: ReactorBase, host: str, port: int, tls: Tls | None) -> int:
        """With TLS nodes cannot tell who answers, as they do not know the authority; what they pull they check by its
        digest. Returns the port."""
        words = f"tcp:{port}:interface={host}"
        if tls is not None:
            files = [endpoints.quoteStringArgument(str(tls.directory / name)) for name in (KEY, CERTIFICATE)]
            words = f"ssl:{port}:interface={host}:privateKey={files[0]}:certKey={files[1]}"
        endpoint = endpoints.serverFromString(reactor, words)
        factory = WrappingFactory(Site(self))
        factory.protocol = _Door
        self._port = await endpoint.listen(factory).asFuture(asyncio.get_running_loop())
        taken = int(self._port.getHost().port)  # type: ignore[misc]  # zope declares it without self
        self.address = f"{host}:{taken}"
        return taken

    def close(self) -> None:
        if self._port is not None:
            self._port.stopListening()  # type: ignore[misc]  # zope declares its methods without self

    def render(self, request: Request) -> Any:
        request.setHeader("Docker-Distribution-Api-Version", "registry/2.0")
        if not hmac.compare_digest(request.getPassword(), self.secret.encode()):
            request.setHeader("WWW-Authenticate", 'Basic realm="rce"')
            return _answer(request, UNAUTHORIZED)
        path = request.path.decode()
        if path == "/v2/":
            return b"{}"
        match = _PATH.fullmatch(path)
        file = self._directory / match[2] if match else None
        if match is None or file is None or not file.is_file():
            return _answer(request, NOT_FOUND)
        request.setHeader("Docker-Content-Digest", f"sha256:{match[2]}")
        kind = MANIFEST if match[1] == "manifests" else "application/octet-stream"
        return File(str(file), defaultType=kind).render(request)


def _answer(request: Request, code: int) -> bytes:
    request.setResponseCode(code)
    return b'{"errors":[]}'
