# ruff: noqa: E402  (imports after importorskip)
"""Image registry for the nodes of a swarm: export of images, requests and authentication."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import io
import json
import ssl
import tarfile
import urllib.error
import urllib.request
from asyncio import to_thread
from collections.abc import AsyncIterator, Iterator
from email.message import Message
from pathlib import Path
from typing import Any, NamedTuple

import pytest

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.swarm.images import MANIFEST, NAME, USER, ImageRegistry, export, sweep
from rce.errors import Unavailable
from rce.net.certificates import Authority
from rce.net.tls import Tls
from tests.support.certificates import certify

CONFIG, FIRST, SECOND = b'{"rootfs":{}}', b"first layer" * 1000, b"second layer"


def digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


IMAGE = digest(CONFIG)


class Api:
    """Docker's API as far as `export` uses it; the third layer is a link to the first."""

    def __init__(self) -> None:
        self.exports = 0

    def get_image(self, image: str) -> Iterator[bytes]:
        assert image == IMAGE
        self.exports += 1
        buffer = io.BytesIO()
        layers = ["a/layer.tar", "b/layer.tar", "c/layer.tar"]
        manifest = json.dumps([{"Config": "config.json", "Layers": layers}]).encode()
        files = {"a/layer.tar": FIRST, "a/VERSION": b"1.0", "b/layer.tar": SECOND, "config.json": CONFIG}
        with tarfile.open(fileobj=buffer, mode="w") as archive:
            for name, data in (files | {"manifest.json": manifest}).items():
                header = tarfile.TarInfo(name)
                header.size = len(data)
                archive.addfile(header, io.BytesIO(data))
            link = tarfile.TarInfo("c/layer.tar")
            link.type, link.linkname = tarfile.SYMTYPE, "../a/layer.tar"
            archive.addfile(link)
        data = buffer.getvalue()
        return iter([data[start : start + 700] for start in range(0, len(data), 700)])


@pytest.fixture
def api() -> Any:
    return Api()


def test_image_is_exported_once(api: Any, tmp_path: Path) -> None:
    reference = export(api, IMAGE, tmp_path)
    assert export(api, IMAGE, tmp_path) == reference
    assert api.exports == 1
    data = (tmp_path / reference.removeprefix("sha256:")).read_bytes()
    assert digest(data) == reference
    manifest = json.loads(data)
    assert manifest["mediaType"] == MANIFEST
    assert manifest["config"]["digest"] == IMAGE
    assert [(layer["digest"], layer["size"]) for layer in manifest["layers"]] == [
        (digest(FIRST), len(FIRST)),
        (digest(SECOND), len(SECOND)),
        (digest(FIRST), len(FIRST)),
    ]
    assert len(list(tmp_path.iterdir())) == 5, "the manifest, its parts and the image's name, nothing else"


def test_unwanted_exports_are_removed(api: Any, tmp_path: Path) -> None:
    export(api, IMAGE, tmp_path)
    (tmp_path / "draft-1").touch()
    sweep(tmp_path, [IMAGE])
    assert len(list(tmp_path.iterdir())) == 5
    sweep(tmp_path, [])
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
async def registry(api: Any, tmp_path: Path) -> AsyncIterator[ImageRegistry]:
    export(api, IMAGE, tmp_path)
    registry = ImageRegistry(tmp_path, "secret of the agents")
    await registry.listen("127.0.0.1", 0, None)
    yield registry
    await registry.close()


class Answer(NamedTuple):
    status: int
    body: bytes
    headers: Message


def basic(secret: str) -> str:
    return f"Basic {base64.b64encode(f'{USER}:{secret}'.encode()).decode()}"


def ask(
    registry: ImageRegistry,
    path: str,
    authorization: str = "",
    method: str = "GET",
    scheme: str = "http",
    **headers: str,
) -> Answer:
    headers["Authorization"] = authorization or basic(registry.secret)
    request = urllib.request.Request(f"{scheme}://{registry.address}{path}", headers=headers, method=method)
    context = ssl._create_unverified_context()  # as Docker on the nodes, which does not know the CA
    try:
        with urllib.request.urlopen(request, timeout=60, context=context) as answer:
            return Answer(answer.status, answer.read(), answer.headers)
    except urllib.error.HTTPError as error:
        with error:
            return Answer(error.code, error.read(), error.headers)


async def test_registry_answers_the_requests_of_a_pull(registry: ImageRegistry, api: Any, tmp_path: Path) -> None:
    assert (await to_thread(ask, registry, "/v2/"))[:2] == (200, b"{}")
    reference = export(api, IMAGE, tmp_path)
    status, manifest, headers = await to_thread(ask, registry, f"/v2/rce/manifests/{reference}")
    assert (status, digest(manifest)) == (200, reference)
    assert (headers["Content-Type"], headers["Docker-Content-Digest"]) == (MANIFEST, reference)
    layer = await to_thread(ask, registry, f"/v2/rce/blobs/{digest(FIRST)}")
    assert layer[:2] == (200, FIRST)
    assert layer.headers["Content-Type"] == "application/octet-stream"


async def test_interrupted_transfer_is_resumed(registry: ImageRegistry) -> None:
    part = await to_thread(ask, registry, f"/v2/rce/blobs/{digest(FIRST)}", Range="bytes=100-199")
    assert part[:2] == (206, FIRST[100:200])


async def test_head_request_gets_the_size_only(registry: ImageRegistry) -> None:
    status, body, headers = await to_thread(ask, registry, f"/v2/rce/blobs/{digest(FIRST)}", method="HEAD")
    assert (status, body, headers["Content-Length"]) == (200, b"", str(len(FIRST)))


@pytest.mark.parametrize("path", ["/v2/", f"/v2/rce/blobs/{digest(FIRST)}"])
@pytest.mark.parametrize(
    "authorization",
    [basic("secret of the agents"), "Basic", "Basic \u00e9", "Bearer x", basic("").replace("Basic", "")],
)
async def test_wrong_password_is_unauthorized(registry: ImageRegistry, path: str, authorization: str) -> None:
    answer = await to_thread(ask, registry, path, authorization)
    assert answer[:2] == (401, b'{"errors":[]}')
    assert answer.headers["WWW-Authenticate"] == 'Basic realm="rce"'


@pytest.mark.parametrize("path", ["/", "/v2/rce/blobs/../../etc/passwd", f"/v2/rce/blobs/sha256:{'0' * 64}"])
async def test_other_paths_are_not_found(registry: ImageRegistry, path: str) -> None:
    assert (await to_thread(ask, registry, path)).status == 404


async def test_images_cannot_be_changed(registry: ImageRegistry) -> None:
    answer = await to_thread(ask, registry, f"/v2/rce/blobs/{digest(FIRST)}", method="DELETE")
    assert (answer.status, answer.headers["Allow"]) == (405, "GET, HEAD")


async def test_tls_handshake_is_refused_at_once_without_tls(registry: ImageRegistry) -> None:
    """Docker tries TLS first, waits 10 s for an answer, and tries plain HTTP only when that has failed."""
    host, _, port = registry.address.rpartition(":")
    async with asyncio.timeout(8):
        with pytest.raises(ssl.SSLError):
            await asyncio.open_connection(host, int(port), ssl=ssl.create_default_context())


async def test_registry_serves_https_with_the_certificate_of_the_machine(api: Any, tmp_path: Path) -> None:
    tls = Tls(certify(tmp_path / "tls", Authority.make("test"), ["127.0.0.1"]))
    registry = ImageRegistry(tmp_path / "images", "secret of the agents")
    await registry.listen("127.0.0.1", 0, tls)
    try:
        assert (await to_thread(ask, registry, "/v2/", scheme="https"))[:2] == (200, b"{}")
    finally:
        await registry.close()


async def test_port_in_use_is_unavailable(registry: ImageRegistry, tmp_path: Path) -> None:
    other = ImageRegistry(tmp_path, "")
    with pytest.raises(Unavailable, match="is in use"):
        await other.listen("127.0.0.1", int(registry.address.rpartition(":")[2]), None)
    await other.close()


async def test_docker_pulls_an_image_without_tls(one_machine: Any, tmp_path: Path) -> None:
    """The daemon takes the registry for insecure: it tries HTTPS, then HTTP."""
    node = one_machine.nodes[0].api()
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("a file of this image only"))
    node.import_image_from_data(content.getvalue(), repository="rce-test/pulled", tag="1")
    image = node.inspect_image("rce-test/pulled:1")["Id"]
    reference = await to_thread(export, node, image, tmp_path)
    node.remove_image("rce-test/pulled:1")
    registry = ImageRegistry(tmp_path, "secret of the agents")
    await registry.listen(one_machine.address, 0, None)
    try:
        identity = {"username": USER, "password": registry.secret}
        async with asyncio.timeout(60):
            await to_thread(node.pull, f"{registry.address}/{NAME}", reference, auth_config=identity)
        assert node.inspect_image(f"{registry.address}/{NAME}@{reference}")["Id"] == image
    finally:
        await registry.close()
        if node.images(filters={"reference": f"{registry.address}/{NAME}"}):
            node.remove_image(image, force=True)
        node.close()
