# ruff: noqa: E402  (imports after importorskip)
"""Image registry for the nodes of a swarm: export of images, requests and authentication."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import tarfile
import urllib.error
import urllib.request
from asyncio import to_thread
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.swarm.images import MANIFEST, USER, ImageRegistry, export, sweep

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
async def registry(api: Any, tmp_path: Path, reactor: ReactorBase) -> AsyncIterator[ImageRegistry]:
    export(api, IMAGE, tmp_path)
    registry = ImageRegistry(tmp_path, "secret of the agents")
    await registry.listen(reactor, "127.0.0.1", 0, None)
    yield registry
    await registry.close()


def get(registry: ImageRegistry, path: str, secret: str = "", **headers: str) -> tuple[int, bytes]:
    words = base64.b64encode(f"{USER}:{secret or registry.secret}".encode()).decode()
    request = urllib.request.Request(
        f"http://{registry.address}{path}", headers={"Authorization": f"Basic {words}", **headers}
    )
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


async def test_registry_answers_the_requests_of_a_pull(registry: ImageRegistry, api: Any, tmp_path: Path) -> None:
    assert await to_thread(get, registry, "/v2/") == (200, b"{}")
    reference = export(api, IMAGE, tmp_path)
    status, manifest = await to_thread(get, registry, f"/v2/rce/manifests/{reference}")
    assert (status, digest(manifest)) == (200, reference)
    assert await to_thread(get, registry, f"/v2/rce/blobs/{digest(FIRST)}") == (200, FIRST)
    part = await to_thread(get, registry, f"/v2/rce/blobs/{digest(FIRST)}", Range="bytes=100-199")
    assert part == (206, FIRST[100:200])


@pytest.mark.parametrize("path", ["/v2/", f"/v2/rce/blobs/{digest(FIRST)}"])
async def test_wrong_password_is_unauthorized(registry: ImageRegistry, path: str) -> None:
    assert (await to_thread(get, registry, path, "secret of the agents"))[0] == 401


@pytest.mark.parametrize("path", ["/", "/v2/rce/blobs/../../etc/passwd", f"/v2/rce/blobs/sha256:{'0' * 64}"])
async def test_other_paths_are_not_found(registry: ImageRegistry, path: str) -> None:
    assert (await to_thread(get, registry, path))[0] == 404
